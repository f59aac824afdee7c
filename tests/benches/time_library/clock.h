// Real and simulated instants, and whether simulated time runs.
#pragma once
#include <time.h>

#include <atomic>
#include <cstdint>

namespace simulated_time {
using Nanoseconds = int64_t;
constexpr Nanoseconds second = 1'000'000'000, never = INT64_MAX;

extern std::atomic<bool> active;

inline Nanoseconds of(const timespec& at) { return at.tv_sec * second + at.tv_nsec; }
inline Nanoseconds real(clockid_t clock) {
  timespec at;
  ::clock_gettime(clock, &at);  // this library's own calls are not redirected
  return of(at);
}

// Something under way while the process is at rest: it counts as lost after some real seconds and looks. Time alone is
// not enough: it also passes while this computer, or just the governor, stands still and looks at nothing.
class Missing {
 public:
  void appears() { since_ = real(CLOCK_MONOTONIC), looks_ = 0; }
  bool lost(int after_s) { return ++looks_ > 400 && real(CLOCK_MONOTONIC) - since_ > after_s * second; }

 private:
  Nanoseconds since_ = 0;
  int looks_ = 0;
};

inline timespec spec(Nanoseconds at) { return {static_cast<time_t>(at / second), static_cast<long>(at % second)}; }
}  // namespace simulated_time
