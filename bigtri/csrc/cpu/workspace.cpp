// The workspaces that no drawing uses, and their memory. Interface and reasons: workspace.h.
#include "workspace.h"

#include <atomic>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include "pages.h"

namespace bigtri {
namespace {

// The most that is kept, of all workspaces together. A million triangles take 50 MB on one thread.
constexpr int64_t kMostKept = int64_t{128} << 20;
// Places for workspaces, some for each thread that draws by itself. There is no lock, which a fork could leave locked for
// ever in the child: a place is taken and filled by one atomic operation.
constexpr int kPlaces = 64;
std::atomic<Workspace*> places[kPlaces];
std::atomic<int64_t> kept{0};  // bytes in all places

constexpr int64_t kAlignment = 64;  // bytes

// Memory of so many bytes begins on a multiple of this, and so does its end.
std::align_val_t unit_of(int64_t bytes) { return std::align_val_t(bytes >= kSmallestHuge ? kHugePage : kAlignment); }

Workspace* taken(std::atomic<Workspace*>& place) {
  Workspace* w = place.load(std::memory_order_relaxed) ? place.exchange(nullptr, std::memory_order_acquire) : nullptr;
  if (w) kept.fetch_sub(w->bytes(), std::memory_order_relaxed);
  return w;
}

}  // namespace

void Buffer::let_go() {
  if (memory_) ::operator delete(memory_, unit_of(bytes_));
  memory_ = nullptr;
  bytes_ = 0;
}

void Buffer::reserve(int64_t bytes) {
  if (bytes <= bytes_) return;
  let_go();
  const int64_t unit = (int64_t)unit_of(bytes);
  bytes = (bytes + unit - 1) / unit * unit;
  memory_ = ::operator new((size_t)bytes, unit_of(bytes));
  bytes_ = bytes;
#if defined(__linux__)
  if (unit == kHugePage) madvise(memory_, (size_t)bytes, MADV_HUGEPAGE);  // a refusal costs time and nothing else
#endif
}

KeptWorkspace::KeptWorkspace() : mine_(nullptr) {
  for (int i = 0; i < kPlaces && !mine_; ++i) mine_ = taken(places[i]);
  if (!mine_) mine_ = new Workspace;
}

KeptWorkspace::~KeptWorkspace() {
  const int64_t bytes = mine_->bytes();
  if (kept.fetch_add(bytes, std::memory_order_relaxed) + bytes <= kMostKept)
    for (std::atomic<Workspace*>& place : places) {
      Workspace* empty = nullptr;
      if (place.compare_exchange_strong(empty, mine_, std::memory_order_release, std::memory_order_relaxed)) return;
    }
  kept.fetch_sub(bytes, std::memory_order_relaxed);
  delete mine_;
}

int64_t kept_workspace_bytes() { return kept.load(std::memory_order_relaxed); }

void release_workspaces() {
  for (std::atomic<Workspace*>& place : places) delete taken(place);
}

}  // namespace bigtri
