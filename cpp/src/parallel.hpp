// Work on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <future>
#include <vector>

namespace plenocal {

/// f(i) for every i below `count`, on so many threads, in any order. Throws what f throws.
template <typename F>
void in_parallel(int count, int threads, const F& f) {
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int i = next++; i < count; i = next++) f(i);
  };
  // They end before this does, whatever is thrown.
  std::vector<std::future<void>> others;
  for (int other = 1; other < std::min(threads, count); ++other) {
    others.push_back(std::async(std::launch::async, work));
  }
  work();
  for (std::future<void>& other : others) other.get();
}

}  // namespace plenocal
