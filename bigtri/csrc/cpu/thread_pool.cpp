// The pool's workers, the job that they share, and what happens at a fork. Interface and reasons: thread_pool.h.
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

// Makes a thread's streaming stores (stream() in simd.h) visible before its later stores. On x86-64, streaming stores
// are not ordered with other stores. A release store is an ordinary store there. Without the fence, another thread
// could see the release store that says the image is done, and read a part that is still in this thread's buffers. A
// locked instruction orders them too, but neither C++ nor this file promises one. One fence per thread and run is
// enough. It is a destructor because a body that throws has stored too.
class StoreFence {
 public:
  StoreFence() = default;
#if defined(__x86_64__)
  ~StoreFence() { _mm_sfence(); }
#else
  ~StoreFence() {}  // stream() is an ordinary store there, as in the baseline of x86-64
#endif
  StoreFence(const StoreFence&) = delete;
  StoreFence& operator=(const StoreFence&) = delete;
};

// One call of run(). It lives on the caller's stack.
struct Job {
  int64_t n;
  void (*body)(void*, int64_t);
  void* context;
  int helpers;                   // workers that may still join
  std::atomic<int64_t> next{0};  // first index that no thread has taken
  std::atomic<bool> failed{false};
  std::exception_ptr error;  // written by the thread that set `failed`; read by the caller when all workers have left

  // One thread's share. It must not throw: nothing would catch a worker's exception, and the caller must not unwind its
  // stack while workers use the job.
  void work() noexcept {
    const StoreFence fence;
    try {
      for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < n;) body(context, i);
    } catch (...) {
      next.store(n, std::memory_order_relaxed);  // no index is left
      if (!failed.exchange(true, std::memory_order_relaxed)) error = std::current_exception();
    }
  }
};

// How often a worker looks for the next job before it sleeps, and the caller whether the last worker has left: some tens of
// microseconds, since a frame is several jobs in a row, and a thread that sleeps takes as long to wake.
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
  std::atomic<int> active{0};  // workers inside the job; written under the mutex
  int workers = 0;  // threads started; under the mutex

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

  // Lets workers join the job; false if the pool is busy with another job. A withdrawn job keeps the pool busy until
  // its last worker has left. The caller of post() may be such a worker, inside a body of that job. If its new job were
  // accepted, withdraw() would wait for `active` to fall to 0, and so for the worker itself.
  bool post(Job* mine) {
    {
      std::lock_guard<std::mutex> lock(mutex);
      if (job.load() || active > 0) return false;
      try {
        for (; workers < mine->helpers; ++workers) std::thread([this] { worker(); }).detach();
      } catch (const std::system_error&) {  // the system gives no more threads; fewer are enough
      }
      job.store(mine);
    }
    job_posted.notify_all();
    return true;
  }

  // Takes the job back. Returns when no worker uses it.
  void withdraw() {
    std::unique_lock<std::mutex> lock(mutex);
    job.store(nullptr);  // a worker that wakes from here on does not join
    if (active == 0) return;
    lock.unlock();
    for (int i = 0; i < kSpins && active.load(std::memory_order_relaxed) > 0; ++i) relax();
    lock.lock();
    worker_left.wait(lock, [&] { return active == 0; });
  }
};

// Initialised at compile time. A static local would have a guard, which another thread could hold while this one forks.
ThreadPool ThreadPool::pool_;

#if !defined(_WIN32)
// A forked child has none of its parent's threads, and one of these may have locked the child's copy of the state for
// ever. So the child starts with a state of its own. The handler only forgets the parent's state, which leaks in the
// child: the child of a process with threads may only call what is safe in a signal handler until exec (POSIX), because
// a thread that no longer exists may hold any lock, the allocator's too. Storing to a lock-free atomic is safe. The
// child's first run() makes the new state. By then the allocator's own handlers have run, and a child that never draws
// allocates nothing.
const int ThreadPool::fork_handler_ = pthread_atfork(nullptr, nullptr, [] { pool_.state_.store(nullptr); });
static_assert(std::atomic<void*>::is_always_lock_free, "the fork handler takes no lock");
#endif

ThreadPool::State& ThreadPool::state() {
  State* s = state_.load(std::memory_order_acquire);
  if (s) return *s;
  State* fresh = new State;
  if (state_.compare_exchange_strong(s, fresh, std::memory_order_acq_rel)) return *fresh;
  delete fresh;  // another thread was first; s is now its state
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
