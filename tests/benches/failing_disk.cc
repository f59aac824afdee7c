// A disk that fails, for one process: what is written to files below a folder is refused, or waits.
//
// Preload it with FAILING_DISK set to the folder; the process calls set_disk_fault, or fail_from for a fault that begins
// at the n-th call that changes the disk: write, truncate, synchronise, create, rename, unlink. With HANGING_DISK set to
// a path, such calls also wait while there is a file: for a process that calls nothing. With HANGING_READS set as well,
// opening and reading wait too; STOPPED_WHILE_HANGING: the first call that waits sends SIGTERM to its process.
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

#include <atomic>

namespace {
std::atomic<int> fault{0}, refused{0}, calls{0}, begins{0}, kind{0}, lasts{0}, paused{0}, only{0};
constexpr int hangs = -1, kills = -3;
constexpr size_t most_names = 1 << 16;
char names[most_names];  // first letters of the calls so far

bool below(const char* path) {
  static const char* folder = getenv("FAILING_DISK");
  return folder != nullptr && !paused && strncmp(path, folder, strlen(folder)) == 0;
}

bool on_the_disk(int descriptor) {
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
  ssize_t size = readlink(link, path, sizeof path - 1);
  if (size < 0) return false;
  path[size] = 0;
  return below(path);
}

void wait_while_it_hangs() {
  static const char *hanging = getenv("HANGING_DISK"), *stopped = getenv("STOPPED_WHILE_HANGING");
  static std::atomic<bool> told{false};
  if (hanging == nullptr || access(hanging, F_OK) != 0) return;
  if (stopped != nullptr && !told.exchange(true)) kill(getpid(), SIGTERM);
  while (access(hanging, F_OK) == 0) usleep(1000);
}

// For calls that change nothing.
void wait_to_read() {
  static const bool reads = getenv("HANGING_READS") != nullptr;
  if (reads) wait_while_it_hangs();
}

// Whether the call fails; errno says why. Waits while the disk hangs.
bool fails_now(char name) {
  wait_while_it_hangs();
  int number = ++calls;
  if (size_t(number) <= most_names) names[number - 1] = name;
  if (begins != 0 && number >= begins && (lasts || number == begins)) {
    if (kind == kills) kill(getpid(), SIGKILL);
    ++refused;
    errno = kind;
    return true;
  }
  if (fault == 0 || (only != 0 && only != name)) return false;
  ++refused;
  while (fault == hangs) usleep(1000);
  errno = fault;
  return fault != 0;
}

bool fails(int descriptor, char name) { return on_the_disk(descriptor) && fails_now(name); }
bool fails(const char* path, char name) { return below(path) && fails_now(name); }

template <typename Function>
Function genuine(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}
}  // namespace

extern "C" {
// The fault of all calls, or of those of one kind, which a letter names.
void set_disk_fault(int number, int kind_of_call) {
  only = kind_of_call;
  fault = number;
}
int disk_faults() { return refused; }
// Fails from the n-th call on, or only at that call. error: its number, or -3: the process is killed before the call.
void fail_from(int number, int error, int lasting) {
  calls = refused = 0;
  kind = error, lasts = lasting;
  begins = number;
}
// While it is 1, calls are neither counted nor refused.
void pause_disk_faults(int whether) { paused = whether; }
const char* disk_call_names() {
  names[calls < int(most_names) ? int(calls) : most_names - 1] = 0;
  return names;
}

ssize_t write(int descriptor, const void* data, size_t size) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t)>("write");
  return fails(descriptor, 'w') ? -1 : real(descriptor, data, size);
}
ssize_t pwrite(int descriptor, const void* data, size_t size, off_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  return fails(descriptor, 'w') ? -1 : real(descriptor, data, size, at);
}
ssize_t pwrite64(int descriptor, const void* data, size_t size, off64_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off64_t)>("pwrite64");
  return fails(descriptor, 'w') ? -1 : real(descriptor, data, size, at);
}
ssize_t pread(int descriptor, void* data, size_t size, off_t at) {
  static auto real = genuine<ssize_t (*)(int, void*, size_t, off_t)>("pread");
  if (on_the_disk(descriptor)) wait_to_read();
  return real(descriptor, data, size, at);
}
ssize_t pread64(int descriptor, void* data, size_t size, off64_t at) {
  static auto real = genuine<ssize_t (*)(int, void*, size_t, off64_t)>("pread64");
  if (on_the_disk(descriptor)) wait_to_read();
  return real(descriptor, data, size, at);
}
int ftruncate(int descriptor, off_t size) {
  static auto real = genuine<int (*)(int, off_t)>("ftruncate");
  return fails(descriptor, 't') ? -1 : real(descriptor, size);
}
int ftruncate64(int descriptor, off64_t size) {
  static auto real = genuine<int (*)(int, off64_t)>("ftruncate64");
  return fails(descriptor, 't') ? -1 : real(descriptor, size);
}
int fsync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fsync");
  return fails(descriptor, 's') ? -1 : real(descriptor);
}
int fdatasync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fdatasync");
  return fails(descriptor, 's') ? -1 : real(descriptor);
}
int rename(const char* from, const char* to) {
  static auto real = genuine<int (*)(const char*, const char*)>("rename");
  return fails(to, 'r') ? -1 : real(from, to);
}
int link(const char* from, const char* to) {
  static auto real = genuine<int (*)(const char*, const char*)>("link");
  return fails(to, 'l') ? -1 : real(from, to);
}
int unlink(const char* path) {
  static auto real = genuine<int (*)(const char*)>("unlink");
  return fails(path, 'u') ? -1 : real(path);
}
#define OPENS(NAME)                                                        \
  int NAME(const char* path, int flags, ...) {                             \
    static auto real = genuine<int (*)(const char*, int, ...)>(#NAME);     \
    va_list more;                                                          \
    va_start(more, flags);                                                 \
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;              \
    va_end(more);                                                          \
    if (below(path)) wait_to_read();                                       \
    if ((flags & O_CREAT) && access(path, F_OK) != 0 && fails(path, 'c')) return -1; \
    return real(path, flags, mode);                                        \
  }
OPENS(open)
OPENS(open64)
}
