// Working memory of a drawing, kept for the next one. The system hands out new memory page by page and clears each page
// first: for a mesh of a million triangles that took a third of the time. A drawing takes a workspace with
// KeptWorkspace and gives it back at its end. What is kept is bounded, and bigtri.memory.release() empties it.
#pragma once

#include <stdint.h>

namespace bigtri {

// Memory that grows. Its content is lost when it does, and not initialised. Objects in it are never destroyed.
class Buffer {
 public:
  Buffer() = default;
  ~Buffer() { let_go(); }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  // Room for n objects, at least; aligned to 64 bytes.
  template <class T>
  T* room(int64_t n) {
    reserve(n * (int64_t)sizeof(T));
    return static_cast<T*>(memory_);
  }
  int64_t bytes() const { return bytes_; }

 private:
  void reserve(int64_t bytes);
  void let_go();

  void* memory_ = nullptr;
  int64_t bytes_ = 0;
};

struct Workspace {
  Buffer vertices, records, candidates, pairs, counts, entries, workers;

  int64_t bytes() const {
    return vertices.bytes() + records.bytes() + candidates.bytes() + pairs.bytes() + counts.bytes() + entries.bytes() +
           workers.bytes();
  }
};

// A workspace for one drawing: one that an earlier drawing has left, else a new one. Any number of threads may have one
// at the same time.
class KeptWorkspace {
 public:
  KeptWorkspace();
  ~KeptWorkspace();
  KeptWorkspace(const KeptWorkspace&) = delete;
  KeptWorkspace& operator=(const KeptWorkspace&) = delete;

  Workspace& operator*() const { return *mine_; }

 private:
  Workspace* mine_;
};

// Bytes of the workspaces that no drawing uses; and gives them back to the system.
int64_t kept_workspace_bytes();
void release_workspaces();

}  // namespace bigtri
