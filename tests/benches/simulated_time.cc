// Simulated time for one process: its monotonic and wall clocks stand still while it works, and go on to the next
// deadline when all of its threads sleep and nothing is under way on its wires.
//
// The calls by which Python reads clocks and waits with a timeout are redirected in the tables through which Python's
// own libraries call the C library (no other library's). Such a wait becomes one without a timeout. A thread of this
// library, the governor, ends the waits with the earliest deadline when everybody has come to rest.
#include <dirent.h>
#include <elf.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <poll.h>
#include <pthread.h>
#include <pty.h>
#include <semaphore.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/ioctl.h>
#include <sys/select.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/sysmacros.h>
#include <sys/time.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <list>
#include <map>
#include <mutex>
#include <string>
#include <tuple>
#include <vector>

namespace {
using Nanoseconds = int64_t;
constexpr Nanoseconds second = 1'000'000'000, never = INT64_MAX;
constexpr Nanoseconds cost_of_a_look = 200;  // so that who polls the clock sees it go on, however fast the computer
constexpr long rest_ns = 30'000, longest_rest_ns = 240'000;  // real time between two looks of the governor

std::atomic<bool> active{false};
std::atomic<Nanoseconds> simulated{0}, wall_offset{0};
std::atomic<uint64_t> waits{0};  // that began or ended
std::atomic<int> for_the_lock{0};  // threads that wait for Python's interpreter lock

Nanoseconds of(const timespec& at) { return at.tv_sec * second + at.tv_nsec; }
timespec spec(Nanoseconds at) { return {static_cast<time_t>(at / second), static_cast<long>(at % second)}; }
Nanoseconds real(clockid_t clock) {
  timespec at;
  ::clock_gettime(clock, &at);  // this library's own calls are not redirected
  return of(at);
}

// ---- Pseudo-terminals ----

// Bytes written at one end reach the other through a queue of the kernel's, later, and nothing shows them until then.
// So those written and read are counted: what was not read and cannot be read yet is under way.
struct End {  // one that reads
  int64_t written = 0, read = 0;
  int fd = -1;
  int64_t written_then = 0, read_then = 0;
  Nanoseconds since = 0;  // real time at which these two were first seen
};
struct Terminal {
  int number;
  bool ours;  // the end that made it
  bool operator<(const Terminal& other) const { return std::tie(number, ours) < std::tie(other.number, other.ours); }
  bool operator==(const Terminal& other) const { return number == other.number && ours == other.ours; }
};
constexpr Terminal none{-1, false};
constexpr Nanoseconds lost_after = 2 * second;  // what has not come then was discarded
std::mutex ends_guard;
std::map<Terminal, End> ends;

Terminal terminal(int fd) {
  struct stat status;
  if (fstat(fd, &status) != 0 || !S_ISCHR(status.st_mode)) return none;
  const unsigned kind = major(status.st_rdev), number = minor(status.st_rdev);
  if (kind >= 136 && kind < 144) return {static_cast<int>(number), false};
  int made = -1;
  return kind == 5 && number == 2 && ioctl(fd, TIOCGPTN, &made) == 0 ? Terminal{made, true} : none;
}

bool find_descriptor(const Terminal& wanted, End& end) {
  if (end.fd >= 0 && terminal(end.fd) == wanted) return true;
  for (end.fd = 0; end.fd < 4096; ++end.fd)
    if (terminal(end.fd) == wanted) return true;
  end.fd = -1;
  return false;
}

// Bytes that have arrived count no more: whoever waits for them is seen as a wait that has ended.
bool wires_are_quiet() {
  std::lock_guard lock(ends_guard);
  for (auto& [at, end] : ends) {
    if (end.written <= end.read) continue;
    int ready = 0;
    if (find_descriptor(at, end)) ioctl(end.fd, FIONREAD, &ready);
    if (end.fd >= 0 && end.read + ready >= end.written) continue;
    const Nanoseconds now = real(CLOCK_MONOTONIC);
    if (end.written != end.written_then || end.read != end.read_then)
      end.written_then = end.written, end.read_then = end.read, end.since = now;
    if (end.fd >= 0 && now - end.since < lost_after) return false;
    end.written = end.read + ready;
  }
  return true;
}

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

void enter(Wait& wait) {
  std::lock_guard lock(guard);
  waiting.push_back(&wait);
  ++waits;
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

// Python waits so for its interpreter lock, in real time. Such a thread has work to do, although it sleeps; so as long as
// there is one, time stands still, even if the kernel happened to show every thread asleep while they took turns.
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

ssize_t write_(int fd, const void* bytes, size_t count) {
  const Terminal at = active ? terminal(fd) : none;
  if (at == none) return ::write(fd, bytes, count);
  const Terminal other{at.number, !at.ours};
  {
    std::lock_guard lock(ends_guard);
    ends[other].written += count;  // before anybody can read them
  }
  const ssize_t written = ::write(fd, bytes, count);
  if (written < static_cast<ssize_t>(count)) {
    const int error = errno;
    std::lock_guard lock(ends_guard);
    ends[other].written -= count - std::max<ssize_t>(written, 0);
    errno = error;
  }
  return written;
}

ssize_t read_(int fd, void* bytes, size_t count) {
  const ssize_t got = ::read(fd, bytes, count);
  if (!active || got <= 0) return got;
  const int error = errno;
  if (const Terminal at = terminal(fd); !(at == none)) {
    std::lock_guard lock(ends_guard);
    End& end = ends[at];
    end.read = std::min(end.read + got, end.written);
  }
  errno = error;
  return got;
}

int tcflush_(int fd, int which) {
  const int failed = ::tcflush(fd, which);
  if (const Terminal at = terminal(fd); active && !(at == none) && which != TCOFLUSH) {
    std::lock_guard lock(ends_guard);
    ends[at].read = ends[at].written;
  }
  return failed;
}

int openpty_(int* ours, int* theirs, char* name, const termios* state, const winsize* size) {
  const int failed = ::openpty(ours, theirs, name, state, size);
  if (!failed && active) {
    std::lock_guard lock(ends_guard);
    ends.erase(terminal(*ours)), ends.erase(terminal(*theirs));
  }
  return failed;
}

// ---- Redirection ----

struct Redirection {
  const char* name;
  void* ours;
};
const Redirection redirections[] = {
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

#if defined(__x86_64__)
constexpr unsigned jump_slot = R_X86_64_JUMP_SLOT, global_data = R_X86_64_GLOB_DAT;
#elif defined(__aarch64__)
constexpr unsigned jump_slot = R_AARCH64_JUMP_SLOT, global_data = R_AARCH64_GLOB_DAT;
#endif

bool is_python(const dl_phdr_info& object) {
  const std::string path = object.dlpi_name;
  if (path.empty()) return true;  // the interpreter itself
  return path.find("python3") != std::string::npos && path.find("site-packages") == std::string::npos;
}

void redirect(const dl_phdr_info& object, const ElfW(Rela)* table, size_t bytes, const ElfW(Sym)* symbols,
              const char* names) {
  for (const auto* entry = table; entry < table + bytes / sizeof(*table); ++entry) {
    const unsigned kind = ELF64_R_TYPE(entry->r_info);
    if (kind != jump_slot && kind != global_data) continue;
    const char* name = names + symbols[ELF64_R_SYM(entry->r_info)].st_name;
    for (const auto& each : redirections) {
      if (strcmp(name, each.name) != 0) continue;
      auto** slot = reinterpret_cast<void**>(object.dlpi_addr + entry->r_offset);
      const long page = sysconf(_SC_PAGESIZE);
      auto* start = reinterpret_cast<void*>(reinterpret_cast<uintptr_t>(slot) & -page);
      mprotect(start, page, PROT_READ | PROT_WRITE);
      *slot = each.ours;
    }
  }
}

int redirect_object(dl_phdr_info* object, size_t, void*) {
  if (!is_python(*object)) return 0;
  for (int i = 0; i < object->dlpi_phnum; ++i) {
    if (object->dlpi_phdr[i].p_type != PT_DYNAMIC) continue;
    std::map<ElfW(Sxword), uintptr_t> of_tag;
    for (auto* entry = reinterpret_cast<ElfW(Dyn)*>(object->dlpi_addr + object->dlpi_phdr[i].p_vaddr);
         entry->d_tag != DT_NULL; ++entry)
      of_tag[entry->d_tag] = entry->d_un.d_ptr;  // the loader has added the base to addresses
    const auto* symbols = reinterpret_cast<const ElfW(Sym)*>(of_tag[DT_SYMTAB]);
    const auto* names = reinterpret_cast<const char*>(of_tag[DT_STRTAB]);
    if (of_tag.count(DT_JMPREL))
      redirect(*object, reinterpret_cast<const ElfW(Rela)*>(of_tag[DT_JMPREL]), of_tag[DT_PLTRELSZ], symbols, names);
    if (of_tag.count(DT_RELA))
      redirect(*object, reinterpret_cast<const ElfW(Rela)*>(of_tag[DT_RELA]), of_tag[DT_RELASZ], symbols, names);
  }
  return 0;
}

// ---- The governor ----

// Whether the kernel shows every other thread of this process asleep; one that was woken and waits for a core is not.
class Threads {
 public:
  ~Threads() {
    for (auto& [_, fd] : files_) close(fd);
  }
  bool all_sleep() {
    const pid_t self = static_cast<pid_t>(syscall(SYS_gettid));
    DIR* tasks = opendir("/proc/self/task");
    bool asleep = true;
    while (const dirent* task = asleep ? readdir(tasks) : nullptr) {
      const pid_t id = atoi(task->d_name);
      if (id != 0 && id != self) asleep = sleeps(id);
    }
    closedir(tasks);
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
  std::map<pid_t, int> files_;
};

std::atomic<uint64_t> steps{0};
pthread_t governor;

void* govern(void*) {
  Threads threads;
  timespec rest{0, rest_ns};
  uint64_t waits_then = 0;
  Nanoseconds since = 0;  // real time at which these were first seen, and one of them ended
  while (active) {
    ::clock_nanosleep(CLOCK_MONOTONIC, 0, &rest, nullptr);
    rest.tv_nsec = std::min(2 * rest.tv_nsec, longest_rest_ns);  // work goes on; looks cost, too
    const uint64_t before = waits;
    if (!threads.all_sleep()) continue;
    if (!wires_are_quiet() || !threads.all_sleep()) continue;
    std::lock_guard lock(guard);
    if (waits != before || for_the_lock != 0) continue;
    if (std::any_of(waiting.begin(), waiting.end(), [](const Wait* wait) { return ended(*wait); })) {
      const Nanoseconds now = real(CLOCK_MONOTONIC);
      if (before != waits_then) waits_then = before, since = now;
      if (now - since < lost_after) continue;  // later: somebody closed what this thread still waits for
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

extern "C" {
double real_monotonic_s() { return real(CLOCK_MONOTONIC) * 1e-9; }

uint64_t steps_of_simulated_time() { return steps; }

void jump_simulated_wall_clock(long seconds) { wall_offset += seconds * second; }

void begin_simulated_time() {
  dl_iterate_phdr(redirect_object, nullptr);  // libraries may have been loaded since the last time
  simulated = real(CLOCK_MONOTONIC);
  wall_offset = real(CLOCK_REALTIME) - simulated;
  ends.clear();
  active = true;
  pthread_create(&governor, nullptr, govern, nullptr);
}

void end_simulated_time() {
  active = false;
  pthread_join(governor, nullptr);
  std::lock_guard lock(guard);
  for (auto* wait : waiting) expire(*wait);
}
}
