// Pages of new memory, which the system clears when a thread first writes to them.
#pragma once

#include <stdint.h>

#if defined(__linux__)
#include <sys/mman.h>
#include <unistd.h>
#endif

#include "parallel.h"

namespace bigtri {

constexpr int64_t kHugePage = int64_t{2} << 20;  // bytes
constexpr int64_t kSmallestHuge = 2 * kHugePage;  // bytes: smaller memory is in ordinary pages

// Whether nothing has been written to memory of so many bytes yet, asked of the page in its middle. False where the system
// does not say.
inline bool is_new(const void* memory, int64_t bytes) {
#if defined(__linux__)
  const uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), middle = (uintptr_t)memory + (uintptr_t)bytes / 2;
  unsigned char resident = 1;
  return mincore((void*)(middle / page * page), 1, &resident) == 0 && !(resident & 1);
#else
  return false;
#endif
}

// Two threads that write to a new page at the same time both clear it. So each touches pages of its own before any of them
// writes what it has to. memory: of so many values, all of which are to be overwritten, or null.
template <class T>
void touch_if_new(T* memory, int64_t count, const Parallel& parallel) {
  const int64_t bytes = count * (int64_t)sizeof(T);
  if (parallel.threads == 1 || !memory || bytes < kSmallestHuge || !is_new(memory, bytes)) return;
  parallel((bytes + kHugePage - 1) / kHugePage,
           [&](int64_t page) { *(reinterpret_cast<volatile char*>(memory) + page * kHugePage) = 0; });
}

}  // namespace bigtri
