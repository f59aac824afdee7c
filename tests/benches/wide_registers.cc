// Loaded before the C library (LD_PRELOAD) into User Mode Linux: its processes' registers, where the processor has more
// than it knows.
//
// It keeps their floating-point registers in a buffer of fixed size, which a processor with AMX exceeds. The kernel
// gives a part of the set, but takes only the whole (ptrace(2), NT_X86_XSTATE): what is missing is added here as it is.

#include <dlfcn.h>
#include <elf.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

#include <cstdarg>
#include <cstring>

namespace {
using Ptrace = long (*)(long, ...);
constexpr size_t kMost = 1 << 16;
}  // namespace

extern "C" long ptrace(enum __ptrace_request request, ...) noexcept {
  static const auto real = reinterpret_cast<Ptrace>(dlsym(RTLD_NEXT, "ptrace"));
  va_list given;
  va_start(given, request);
  const long process = va_arg(given, long);
  void* const address = va_arg(given, void*);
  void* const data = va_arg(given, void*);
  va_end(given);
  if (request == PTRACE_SETREGSET && reinterpret_cast<long>(address) == NT_X86_XSTATE) {
    static char whole[kMost];  // the guest has one processor
    const auto* const known = static_cast<const iovec*>(data);
    iovec all = {whole, sizeof whole};
    if (real(PTRACE_GETREGSET, process, address, &all) == 0 && known->iov_len < all.iov_len) {
      std::memcpy(whole, known->iov_base, known->iov_len);
      return real(request, process, address, &all);
    }
  }
  return real(request, process, address, data);
}
