// Real and simulated instants, and whether simulated time runs.
#pragma once
#include <time.h>

#include <atomic>
#include <cstdint>

namespace simulated_time {
using Nanoseconds = int64_t;
constexpr Nanoseconds second = 1'000'000'000, never = INT64_MAX;
constexpr Nanoseconds lost_after = 2 * second;  // what has not come then was discarded

extern std::atomic<bool> active;

inline Nanoseconds of(const timespec& at) { return at.tv_sec * second + at.tv_nsec; }
inline timespec spec(Nanoseconds at) { return {static_cast<time_t>(at / second), static_cast<long>(at % second)}; }
inline Nanoseconds real(clockid_t clock) {
  timespec at;
  ::clock_gettime(clock, &at);  // this library's own calls are not redirected
  return of(at);
}
}  // namespace simulated_time
