// Records what a process does to the files below a folder, in order, so that the disk can be rebuilt as a power cut at
// any moment could have left it.
//
// Preload it with POWER_CUT_FOLDER and POWER_CUT_LOG set. Each record: what, inode, place, size, seconds, then the data.
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <mutex>

namespace {
std::recursive_mutex order;

const char* folder() {
  static const char* found = getenv("POWER_CUT_FOLDER");
  return found;
}

bool below(const char* path) {
  return folder() != nullptr && strncmp(path, folder(), strlen(folder())) == 0;
}

bool name_of(int descriptor, char* path, size_t size) {
  char link[64];
  snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
  ssize_t length = readlink(link, path, size - 1);
  if (length < 0) return false;
  path[length] = 0;
  return below(path);
}

bool watched(int descriptor) {
  char path[4096];
  return folder() != nullptr && name_of(descriptor, path, sizeof path);
}

uint64_t inode(int descriptor) {
  struct stat found{};
  return fstat(descriptor, &found) == 0 ? found.st_ino : 0;
}

void put(const void* data, size_t size) {
  static int log = open(getenv("POWER_CUT_LOG"), O_WRONLY | O_CREAT | O_APPEND, 0600);
  while (size > 0) {
    ssize_t done = syscall(SYS_write, log, data, size);
    if (done <= 0) abort();
    data = static_cast<const char*>(data) + done;
    size -= done;
  }
}

void note(char what, uint64_t file, int64_t at, const void* data, uint64_t size) {
  struct timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  struct {
    uint64_t what, file;
    int64_t at;
    uint64_t size;
    double seconds;
  } head{static_cast<uint64_t>(what), file, at, size, now.tv_sec + now.tv_nsec * 1e-9};
  put(&head, sizeof head);
  put(data, size);
}

template <typename Function>
Function genuine(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

int opened(const char* path, int flags, int descriptor) {
  if (descriptor >= 0 && (flags & O_CREAT) && below(path)) {
    struct stat found{};
    fstat(descriptor, &found);
    note('n', found.st_ino, found.st_size, path, strlen(path));
  }
  return descriptor;
}

template <typename Write>
ssize_t written(int descriptor, const void* data, off64_t at, Write write) {
  if (!watched(descriptor)) return write();
  std::lock_guard<std::recursive_mutex> one_at_a_time(order);
  ssize_t done = write();
  if (done > 0) note('w', inode(descriptor), at, data, done);
  return done;
}

template <typename Call>
int followed(char what, int descriptor, int64_t at, Call call) {
  if (!watched(descriptor)) return call();
  std::lock_guard<std::recursive_mutex> one_at_a_time(order);
  int answer = call();
  if (answer == 0) note(what, inode(descriptor), at, "", 0);
  return answer;
}
}  // namespace

extern "C" {
// Marks what was reported to the process as being on the disk, or what it has handed in.
void power_cut_mark(int64_t kind, int64_t number) {
  std::lock_guard<std::recursive_mutex> one_at_a_time(order);
  note('m', kind, number, "", 0);
}

int open(const char* path, int flags, ...) {
  static auto real = genuine<int (*)(const char*, int, ...)>("open");
  va_list more;
  va_start(more, flags);
  int mode = va_arg(more, int);
  va_end(more);
  std::lock_guard<std::recursive_mutex> one_at_a_time(order);
  return opened(path, flags, real(path, flags, mode));
}
// With 64-bit offsets, as on every Linux of today, it is the same call.
int open64(const char* path, int flags, ...) __attribute__((alias("open")));
int unlink(const char* path) {
  static auto real = genuine<int (*)(const char*)>("unlink");
  std::lock_guard<std::recursive_mutex> one_at_a_time(order);
  int answer = real(path);
  if (answer == 0 && below(path)) note('u', 0, 0, path, strlen(path));
  return answer;
}
ssize_t write(int descriptor, const void* data, size_t size) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t)>("write");
  return written(descriptor, data, lseek(descriptor, 0, SEEK_CUR), [&] { return real(descriptor, data, size); });
}
ssize_t pwrite(int descriptor, const void* data, size_t size, off_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  return written(descriptor, data, at, [&] { return real(descriptor, data, size, at); });
}
ssize_t pwrite64(int descriptor, const void* data, size_t size, off64_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off64_t)>("pwrite64");
  return written(descriptor, data, at, [&] { return real(descriptor, data, size, at); });
}
int ftruncate(int descriptor, off_t size) {
  static auto real = genuine<int (*)(int, off_t)>("ftruncate");
  return followed('t', descriptor, size, [&] { return real(descriptor, size); });
}
int ftruncate64(int descriptor, off64_t size) {
  static auto real = genuine<int (*)(int, off64_t)>("ftruncate64");
  return followed('t', descriptor, size, [&] { return real(descriptor, size); });
}
int fsync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fsync");
  return followed('s', descriptor, 0, [&] { return real(descriptor); });
}
int fdatasync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fdatasync");
  return followed('s', descriptor, 0, [&] { return real(descriptor); });
}
}
