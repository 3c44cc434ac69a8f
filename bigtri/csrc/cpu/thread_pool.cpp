#include "thread_pool.h"

#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>

#if !defined(_WIN32)
#include <pthread.h>
#endif

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace bigtri {
namespace {

// Makes a thread's streaming stores (stream() in simd.h) visible before anything it stores later. They pass the caches
// and, on x86-64, also the order in which a thread's other stores appear: without this fence another thread could be
// told that the image is done, by a release store, which is an ordinary one there, and read a part that still waits in
// this one's buffers. A locked instruction orders them too, but neither C++ nor this file promises one. One fence is
// enough for all that a thread does in a run, and a body that throws has stored too.
class StoreFence {
 public:
  StoreFence() = default;
#if defined(__x86_64__)
  ~StoreFence() { _mm_sfence(); }
#else
  ~StoreFence() {}  // stream() is an ordinary store there
#endif
  StoreFence(const StoreFence&) = delete;
  StoreFence& operator=(const StoreFence&) = delete;
};

struct Job {
  int64_t n;
  void (*body)(void*, int64_t);
  void* context;
  int helpers;  // workers that may still join
  std::atomic<int64_t> next{0};
  std::atomic<bool> failed{false};
  std::exception_ptr error;  // written by the thread that set `failed`, read by the caller when all have left

  // One thread's share. Nothing is thrown here: a worker has nobody above it to catch, and the caller must not leave
  // while workers still use the job, which lives on its stack.
  void work() noexcept {
    const StoreFence fence;
    try {
      for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < n;) body(context, i);
    } catch (...) {
      next.store(n, std::memory_order_relaxed);  // no thread starts another index
      if (!failed.exchange(true, std::memory_order_relaxed)) error = std::current_exception();
    }
  }
};

// A frame is several jobs in a row: a worker looks for the next one this often before it sleeps, some tens of
// microseconds.
constexpr int kSpins = 2000;

inline void relax() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

}  // namespace

struct ThreadPool::State {
  std::mutex mutex;
  std::condition_variable job_posted, worker_left;
  std::atomic<Job*> job{nullptr};  // written under the mutex
  int active = 0;                  // workers inside the job
  int workers = 0;

  void worker() {
    for (;;) {
      for (int i = 0; i < kSpins && !job.load(std::memory_order_relaxed); ++i) relax();
      std::unique_lock<std::mutex> lock(mutex);
      job_posted.wait(lock, [&] { return job.load() && job.load()->helpers > 0; });
      Job* mine = job.load();
      --mine->helpers;
      ++active;
      lock.unlock();
      mine->work();
      lock.lock();
      if (--active == 0) worker_left.notify_all();
    }
  }

  // Lets workers join the job, unless the pool is busy with another one: then false. A job that was withdrawn keeps the
  // pool busy until its last worker has left: one of them may be the caller here, from inside its body, and waiting
  // for `active` to fall to zero it would wait for itself.
  bool post(Job* mine) {
    {
      std::lock_guard<std::mutex> lock(mutex);
      if (job.load() || active > 0) return false;
      try {
        for (; workers < mine->helpers; ++workers) std::thread([this] { worker(); }).detach();
      } catch (const std::system_error&) {  // no more threads to be had: fewer do
      }
      job.store(mine);
    }
    job_posted.notify_all();
    return true;
  }

  // Returns when no worker uses the job any more.
  void withdraw() {
    std::unique_lock<std::mutex> lock(mutex);
    job.store(nullptr);  // whoever wakes now has missed it
    worker_left.wait(lock, [&] { return active == 0; });
  }
};

// Initialised before any code runs, so that there is no guard that another thread could hold while this one forks.
ThreadPool ThreadPool::pool_;

#if !defined(_WIN32)
// A child has none of its parent's threads, and its copy of the state may be locked by one of them for ever: it starts
// with a state of its own. The handler does no more than forget the parent's (which is lost to the child: freeing it
// would take the allocator). Between fork and exec a child of several threads may only call what is safe in a signal
// handler (POSIX), since any lock, the allocator's among them, may be held by a thread that is not there; storing to a
// lock-free atomic is. The new state is made by the child's first run(), outside the handler: by then the allocator's
// own handlers have run, and a child that never draws allocates nothing.
const int ThreadPool::fork_handler_ = pthread_atfork(nullptr, nullptr, [] { pool_.state_.store(nullptr); });
static_assert(std::atomic<void*>::is_always_lock_free, "the fork handler takes no lock");
#endif

ThreadPool::State& ThreadPool::state() {
  State* s = state_.load(std::memory_order_acquire);
  if (s) return *s;
  State* fresh = new State;
  if (state_.compare_exchange_strong(s, fresh, std::memory_order_acq_rel)) return *fresh;
  delete fresh;  // another thread was first: s is its state
  return *s;
}

void ThreadPool::run(int threads, int64_t n, void (*body)(void*, int64_t), void* context) {
  Job job;
  job.n = n;
  job.body = body;
  job.context = context;
  job.helpers = (int)(n < threads ? n : threads) - 1;
  State* shared = job.helpers > 0 ? &state() : nullptr;
  if (!shared || !shared->post(&job)) {
    const StoreFence fence;
    for (int64_t i = 0; i < n; ++i) body(context, i);
    return;
  }
  job.work();
  shared->withdraw();
  if (job.error) std::rethrow_exception(job.error);
}

}  // namespace bigtri
