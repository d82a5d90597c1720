#!/bin/sh
# Runs a test built with ThreadSanitizer, or says why it is impossible and returns 77, which CTest
# counts as skipped: run_tsan.sh [TEST]
if [ -z "$1" ]; then
  echo "skipped: the compiler cannot build with ThreadSanitizer"
  exit 77
fi
# With strong address randomisation the sanitizer does not start.
for prefix in "setarch $(uname -m) -R" ""; do
  if $prefix "$1" --gtest_list_tests > /dev/null 2>&1; then
    exec $prefix "$1"
  fi
done
echo "skipped: ThreadSanitizer does not start on this machine"
exit 77
