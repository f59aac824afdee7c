#include "redirection.h"

#include <elf.h>
#include <link.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <map>
#include <string>

namespace simulated_time {
namespace {
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
              const char* names, const Redirections& redirections) {
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

int redirect_object(dl_phdr_info* object, size_t, void* data) {
  const auto& redirections = *static_cast<const Redirections*>(data);
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
      redirect(*object, reinterpret_cast<const ElfW(Rela)*>(of_tag[DT_JMPREL]), of_tag[DT_PLTRELSZ], symbols, names,
               redirections);
    if (of_tag.count(DT_RELA))
      redirect(*object, reinterpret_cast<const ElfW(Rela)*>(of_tag[DT_RELA]), of_tag[DT_RELASZ], symbols, names, redirections);
  }
  return 0;
}
}  // namespace

void redirect_python(const Redirections& redirections) {
  dl_iterate_phdr(redirect_object, const_cast<Redirections*>(&redirections));
}
}  // namespace simulated_time
