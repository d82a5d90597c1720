// Work on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <future>
#include <vector>

namespace plenocal {

/// Calls f(i) for every i below `count` on `threads` threads, in any order. Throws the exceptions
/// of f.
template <typename F>
void in_parallel(int count, int threads, const F& f) {
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int i = next++; i < count; i = next++) f(i);
  };
  // The destructors of these futures wait for their threads, even after an exception.
  std::vector<std::future<void>> others;
  for (int other = 1; other < std::min(threads, count); ++other) {
    others.push_back(std::async(std::launch::async, work));
  }
  work();
  for (std::future<void>& other : others) other.get();
}

}  // namespace plenocal
