// Simulated time for one process: its monotonic and wall clocks stand still while it works, and go on to the next
// deadline when all of its threads sleep and nothing is under way on its wires.
//
// The calls by which Python reads clocks and waits with a timeout are redirected in the tables through which Python's
// own libraries call the C library (no other library's). Such a wait becomes one without a timeout. A thread of this
// library, the governor, ends the waits with the earliest deadline when everybody has come to rest.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/select.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <iterator>
#include <list>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "clock.h"
#include "redirection.h"
#include "terminals.h"

namespace simulated_time {
std::atomic<bool> active{false};

namespace {
constexpr Nanoseconds cost_of_a_look = 200;  // a poller sees the clock advance, however fast the computer is
constexpr long rest_ns = 30'000, longest_rest_ns = 240'000;  // real time between two looks of the governor

std::atomic<Nanoseconds> simulated{0}, wall_offset{0};
std::atomic<uint64_t> waits{0};  // that began or ended
std::atomic<int> for_the_lock{0};  // threads that wait for Python's interpreter lock
std::atomic<int> holds{0};  // of threads that wait for something, such as another process, while time must not pass

// ---- Waits ----

struct Wait {
  Nanoseconds deadline;
  sem_t* semaphore;  // posted to end the wait; else the event is
  int event;
  const pollfd* fds = nullptr;
  nfds_t count = 0;
  bool expired = false;
};
std::mutex guard;
std::list<Wait*> waiting;
std::condition_variable governed;  // somebody waits for a deadline, or the governor's work is done

void enter(Wait& wait) {
  std::lock_guard lock(guard);
  waiting.push_back(&wait);
  ++waits;
  governed.notify_one();
}
bool leave(Wait& wait) {
  std::lock_guard lock(guard);
  waiting.remove(&wait);
  ++waits;
  return wait.expired;
}
void expire(Wait& wait) {
  wait.expired = true;
  if (wait.semaphore) sem_post(wait.semaphore);
  else eventfd_write(wait.event, 1);
}

// A wait that something has ended already, although the kernel may not have woken its thread yet.
bool ended(const Wait& wait) {
  std::vector<pollfd> all(wait.fds, wait.fds + wait.count);
  ::poll(all.data(), all.size(), 0);
  const auto ready = [](const pollfd& fd) { return (fd.revents & ~POLLNVAL) != 0; };
  return wait.expired || std::any_of(all.begin(), all.end(), ready);
}

struct Event {  // one a thread
  int fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  ~Event() { close(fd); }
};
int event_of_this_thread() {
  thread_local Event event;
  return event.fd;
}

// Polls without a timeout until the descriptors are ready or the deadline has come: then 0.
int wait_for(pollfd* fds, nfds_t count, Nanoseconds deadline) {
  std::vector<pollfd> all(fds, fds + count);
  const int event = event_of_this_thread();
  all.push_back({event, POLLIN, 0});
  Wait wait{deadline, nullptr, event, fds, count};
  enter(wait);
  int ready = ::poll(all.data(), all.size(), -1);
  const int error = errno;
  if (leave(wait)) {
    eventfd_t ignored;
    eventfd_read(event, &ignored);
    if (ready > 0) ready = ::poll(all.data(), count, 0);
  }
  for (nfds_t i = 0; i < count; ++i) fds[i].revents = ready > 0 ? all[i].revents : 0;
  errno = error;
  return ready;
}

Nanoseconds after_ms(int timeout) { return simulated + timeout * (second / 1000); }

// ---- What Python calls in place of the C library ----

int clock_gettime_(clockid_t clock, timespec* at) {
  if (!active) return ::clock_gettime(clock, at);
  switch (clock) {
    case CLOCK_MONOTONIC: case CLOCK_MONOTONIC_RAW: case CLOCK_MONOTONIC_COARSE: case CLOCK_BOOTTIME:
      *at = spec(simulated += cost_of_a_look);
      return 0;
    case CLOCK_REALTIME: case CLOCK_REALTIME_COARSE:
      *at = spec((simulated += cost_of_a_look) + wall_offset);
      return 0;
    default:
      return ::clock_gettime(clock, at);
  }
}

int gettimeofday_(timeval* at, void*) {
  timespec now;
  const int failed = clock_gettime_(CLOCK_REALTIME, &now);
  *at = {now.tv_sec, now.tv_nsec / 1000};
  return failed;
}

time_t time_(time_t* at) {
  timespec now;
  clock_gettime_(CLOCK_REALTIME, &now);
  if (at) *at = now.tv_sec;
  return now.tv_sec;
}

int sem_clockwait_(sem_t* semaphore, clockid_t clock, const timespec* until) {
  if (!active) return ::sem_clockwait(semaphore, clock, until);
  if (sem_trywait(semaphore) == 0) return 0;
  Wait wait{of(*until) - (clock == CLOCK_REALTIME ? wall_offset.load() : 0), semaphore, -1};
  enter(wait);
  int failed = ::sem_wait(semaphore);
  int error = errno;
  if (leave(wait)) {  // one post is the governor's; a second is somebody else's, and ends the wait with success
    if (!failed && sem_trywait(semaphore) != 0) failed = -1, error = ETIMEDOUT;
    else if (failed) sem_trywait(semaphore);
  }
  errno = error;
  return failed;
}

int sem_timedwait_(sem_t* semaphore, const timespec* until) {
  return active ? sem_clockwait_(semaphore, CLOCK_REALTIME, until) : ::sem_timedwait(semaphore, until);
}

// Python waits in this way for its interpreter lock, in real time. Such a thread has work to do, although it sleeps; so
// as long as there is one, time stands still, even if the kernel happened to show every thread asleep while they took
// turns.
struct LockWait {
  LockWait() { ++for_the_lock, ++waits; }
  ~LockWait() { --for_the_lock, ++waits; }
};

int pthread_cond_timedwait_(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* until) {
  const LockWait counted;
  if (!active) return ::pthread_cond_timedwait(condition, mutex, until);
  const Nanoseconds left = std::clamp<Nanoseconds>(of(*until) - simulated, 0, second / 100);
  const timespec at = spec(real(CLOCK_MONOTONIC) + left);
  return ::pthread_cond_timedwait(condition, mutex, &at);
}

int pthread_cond_wait_(pthread_cond_t* condition, pthread_mutex_t* mutex) {
  const LockWait counted;
  return ::pthread_cond_wait(condition, mutex);
}

int clock_nanosleep_(clockid_t clock, int flags, const timespec* wanted, timespec* left) {
  if (!active) return ::clock_nanosleep(clock, flags, wanted, left);
  wait_for(nullptr, 0, flags & TIMER_ABSTIME ? of(*wanted) : simulated + of(*wanted));
  return 0;
}

int poll_(pollfd* fds, nfds_t count, int timeout) {
  if (!active || timeout <= 0) return ::poll(fds, count, timeout);
  return wait_for(fds, count, after_ms(timeout));
}

int epoll_wait_(int epoll, epoll_event* events, int most, int timeout) {
  if (!active || timeout == 0) return ::epoll_wait(epoll, events, most, timeout);
  pollfd fd{epoll, POLLIN, 0};
  const int ready = wait_for(&fd, 1, timeout < 0 ? never : after_ms(timeout));
  return ready < 0 ? ready : ::epoll_wait(epoll, events, most, 0);
}

int select_(int count, fd_set* reading, fd_set* writing, fd_set* excepting, timeval* timeout) {
  if (!active || !timeout || (timeout->tv_sec == 0 && timeout->tv_usec == 0))
    return ::select(count, reading, writing, excepting, timeout);
  std::vector<pollfd> fds;
  for (int fd = 0; fd < count; ++fd) {
    const short events = (reading && FD_ISSET(fd, reading) ? POLLIN : 0) | (writing && FD_ISSET(fd, writing) ? POLLOUT : 0) |
                         (excepting && FD_ISSET(fd, excepting) ? POLLPRI : 0);
    if (events) fds.push_back({fd, events, 0});
  }
  const int ready = wait_for(fds.data(), fds.size(), simulated + timeout->tv_sec * second + timeout->tv_usec * 1000);
  if (ready < 0) return ready;
  timeval now{0, 0};
  return ::select(count, reading, writing, excepting, &now);
}

// Waits without a timeout stay as they are; that they begin and end is noted.
int sem_wait_(sem_t* semaphore) {
  ++waits;
  const int failed = ::sem_wait(semaphore);
  ++waits;
  return failed;
}

const Redirections redirections = {
    {"clock_gettime", reinterpret_cast<void*>(clock_gettime_)},
    {"gettimeofday", reinterpret_cast<void*>(gettimeofday_)},
    {"time", reinterpret_cast<void*>(time_)},
    {"sem_clockwait", reinterpret_cast<void*>(sem_clockwait_)},
    {"sem_timedwait", reinterpret_cast<void*>(sem_timedwait_)},
    {"pthread_cond_timedwait", reinterpret_cast<void*>(pthread_cond_timedwait_)},
    {"pthread_cond_wait", reinterpret_cast<void*>(pthread_cond_wait_)},
    {"clock_nanosleep", reinterpret_cast<void*>(clock_nanosleep_)},
    {"poll", reinterpret_cast<void*>(poll_)},
    {"epoll_wait", reinterpret_cast<void*>(epoll_wait_)},
    {"select", reinterpret_cast<void*>(select_)},
    {"sem_wait", reinterpret_cast<void*>(sem_wait_)},
    {"write", reinterpret_cast<void*>(write_)},
    {"read", reinterpret_cast<void*>(read_)},
    {"tcflush", reinterpret_cast<void*>(tcflush_)},
    {"openpty", reinterpret_cast<void*>(openpty_)},
};

// ---- The governor ----

// Whether the kernel shows every other thread of this process asleep; one that was woken and waits for a core is not.
class Threads {
 public:
  ~Threads() {
    for (auto& [_, fd] : files_) close(fd);
    closedir(tasks_);
  }
  bool all_sleep() {
    rewinddir(tasks_);
    bool asleep = true;
    std::set<pid_t> there;
    while (const dirent* task = asleep ? readdir(tasks_) : nullptr) {
      const pid_t id = atoi(task->d_name);
      if (id == 0 || id == self_) continue;
      asleep = sleeps(id);
      there.insert(id);
    }
    if (asleep) forget_all_but(there);
    return asleep;
  }

 private:
  bool sleeps(pid_t id) {
    auto found = files_.find(id);
    if (found == files_.end()) {
      const std::string path = "/proc/self/task/" + std::to_string(id) + "/stat";
      const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
      if (fd < 0) return false;  // just ended
      found = files_.emplace(id, fd).first;
    }
    char text[256];
    const ssize_t size = pread(found->second, text, sizeof text - 1, 0);
    if (size <= 0) {  // ended, and its number may be another's
      close(found->second);
      files_.erase(found);
      return false;
    }
    text[size] = 0;
    const char* end = strrchr(text, ')');
    return end && end[2] == 'S';
  }
  void forget_all_but(const std::set<pid_t>& there) {  // of a thread that ended, the file would stay open
    for (auto file = files_.begin(); file != files_.end();) {
      const bool kept = there.count(file->first) != 0;
      if (!kept) close(file->second);
      file = kept ? std::next(file) : files_.erase(file);
    }
  }
  const pid_t self_ = static_cast<pid_t>(syscall(SYS_gettid));
  DIR* const tasks_ = opendir("/proc/self/task");
  std::map<pid_t, int> files_;
};

std::atomic<uint64_t> steps{0};
pthread_t governor;

void* govern(void*) {
  prctl(PR_SET_TIMERSLACK, 1);  // else the kernel adds 50 us to each rest
  Threads threads;
  timespec rest{0, rest_ns};
  uint64_t waits_then = 0;
  Missing missing;  // since these were first seen, and one of them ended
  while (active) {
    if (std::unique_lock lock(guard); waiting.empty()) {  // nothing to end, and no need to look who sleeps
      governed.wait(lock, [] { return !waiting.empty() || !active; });
      rest.tv_nsec = rest_ns;
    }
    ::clock_nanosleep(CLOCK_MONOTONIC, 0, &rest, nullptr);
    rest.tv_nsec = std::min(2 * rest.tv_nsec, longest_rest_ns);  // work goes on; looks cost, too
    const uint64_t before = waits;
    if (!threads.all_sleep()) continue;
    if (!wires_are_quiet() || !threads.all_sleep()) continue;
    std::lock_guard lock(guard);
    if (waits != before || for_the_lock != 0 || holds != 0) continue;
    if (std::any_of(waiting.begin(), waiting.end(), [](const Wait* wait) { return ended(*wait); })) {
      if (before != waits_then) waits_then = before, missing.appears();
      if (!missing.lost(2)) continue;  // later: somebody closed what this thread still waits for
    }
    Nanoseconds next = never;
    for (const auto* wait : waiting) next = std::min(next, wait->expired ? never : wait->deadline);
    if (next == never) continue;
    simulated = std::max(simulated.load(), next);
    for (auto* wait : waiting)
      if (wait->deadline <= simulated) expire(*wait);
    ++steps;
    rest.tv_nsec = rest_ns;
  }
  return nullptr;
}
}  // namespace
}  // namespace simulated_time

using namespace simulated_time;
extern "C" {
double real_monotonic_s() { return real(CLOCK_MONOTONIC) * 1e-9; }

uint64_t steps_of_simulated_time() { return steps; }

void hold_simulated_time(int more) { holds += more, ++waits; }

void jump_simulated_wall_clock(long seconds) { wall_offset += seconds * second; }

void begin_simulated_time() {
  redirect_python(redirections);  // libraries may have been loaded since the last time
  simulated = real(CLOCK_MONOTONIC);
  wall_offset = real(CLOCK_REALTIME) - simulated;
  forget_terminals();
  active = true;
  pthread_create(&governor, nullptr, govern, nullptr);
}

void end_simulated_time() {
  {
    std::lock_guard lock(guard);
    active = false;
    governed.notify_one();
  }
  pthread_join(governor, nullptr);
  std::lock_guard lock(guard);
  for (auto* wait : waiting) expire(*wait);
}
}
