// A disk that fails, for one process: what is written to files below a folder is refused, or waits.
//
// Preload it with FAILING_DISK set to the folder; the process calls set_disk_fault.
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

#include <atomic>

namespace {
std::atomic<int> fault{0}, refused{0};
constexpr int hangs = -1;

bool on_the_disk(int descriptor) {
  static const char* folder = getenv("FAILING_DISK");
  if (folder == nullptr) return false;
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
  ssize_t size = readlink(link, path, sizeof path - 1);
  if (size < 0) return false;
  path[size] = 0;
  return strncmp(path, folder, strlen(folder)) == 0;
}

// Whether the call fails; errno says why. Waits while the disk hangs.
bool fails(int descriptor) {
  if (fault == 0 || !on_the_disk(descriptor)) return false;
  ++refused;
  while (fault == hangs) usleep(1000);
  errno = fault;
  return fault != 0;
}

template <typename Function>
Function genuine(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}
}  // namespace

extern "C" {
void set_disk_fault(int number) { fault = number; }
int disk_faults() { return refused; }

ssize_t write(int descriptor, const void* data, size_t size) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t)>("write");
  return fails(descriptor) ? -1 : real(descriptor, data, size);
}
ssize_t pwrite(int descriptor, const void* data, size_t size, off_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  return fails(descriptor) ? -1 : real(descriptor, data, size, at);
}
ssize_t pwrite64(int descriptor, const void* data, size_t size, off64_t at) {
  static auto real = genuine<ssize_t (*)(int, const void*, size_t, off64_t)>("pwrite64");
  return fails(descriptor) ? -1 : real(descriptor, data, size, at);
}
int ftruncate(int descriptor, off_t size) {
  static auto real = genuine<int (*)(int, off_t)>("ftruncate");
  return fails(descriptor) ? -1 : real(descriptor, size);
}
int ftruncate64(int descriptor, off64_t size) {
  static auto real = genuine<int (*)(int, off64_t)>("ftruncate64");
  return fails(descriptor) ? -1 : real(descriptor, size);
}
int fsync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fsync");
  return fails(descriptor) ? -1 : real(descriptor);
}
int fdatasync(int descriptor) {
  static auto real = genuine<int (*)(int)>("fdatasync");
  return fails(descriptor) ? -1 : real(descriptor);
}
}
