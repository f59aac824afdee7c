#include "terminals.h"

#include <errno.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <mutex>
#include <tuple>

#include "clock.h"

namespace simulated_time {
namespace {
// Bytes written at one end reach the other through a queue of the kernel's, later, and nothing shows them until then.
// So those written and read are counted: what was not read and cannot be read yet is under way.
struct End {  // one that reads
  int64_t written = 0, read = 0;
  int fd = -1;
  int64_t written_then = 0, read_then = 0;
  Missing missing;  // since these two were first seen
};
struct Terminal {
  int number;
  bool ours;  // the end that made it
  bool operator<(const Terminal& other) const { return std::tie(number, ours) < std::tie(other.number, other.ours); }
  bool operator==(const Terminal& other) const { return number == other.number && ours == other.ours; }
};
constexpr Terminal none{-1, false};
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
}  // namespace

// Bytes that have arrived count no more: whoever waits for them is seen as a wait that has ended.
bool wires_are_quiet() {
  std::lock_guard lock(ends_guard);
  for (auto& [at, end] : ends) {
    if (end.written <= end.read) continue;
    int ready = 0;
    const bool gone = find_descriptor(at, end) && ioctl(end.fd, FIONREAD, &ready) != 0;  // the other end has hung up
    if (end.fd >= 0 && !gone && end.read + ready >= end.written) continue;
    if (end.written != end.written_then || end.read != end.read_then) {
      end.written_then = end.written, end.read_then = end.read;
      end.missing.appears();
    }
    if (end.fd >= 0 && !gone && !end.missing.lost(10)) return false;
    end.written = end.read + ready;
  }
  return true;
}

void forget_terminals() {
  std::lock_guard lock(ends_guard);
  ends.clear();
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
}  // namespace simulated_time
