// The wall clock of one process, as somebody sets it: loaded before the C library, whose monotonic clocks stay.
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>

#include <atomic>

namespace {
std::atomic<long> ahead_s{0};

int ask(clockid_t clock, timespec* at) {
  using Ask = int (*)(clockid_t, timespec*);
  static const Ask system = reinterpret_cast<Ask>(dlsym(RTLD_NEXT, "clock_gettime"));
  return system(clock, at);
}
}  // namespace

extern "C" {
void jump_wall_clock(long seconds) { ahead_s += seconds; }

int clock_gettime(clockid_t clock, timespec* at) noexcept {
  const int failed = ask(clock, at);
  if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) at->tv_sec += ahead_s;
  return failed;
}

int gettimeofday(timeval* at, void*) noexcept {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  *at = {now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

time_t time(time_t* at) noexcept {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (at) *at = now.tv_sec;
  return now.tv_sec;
}
}
