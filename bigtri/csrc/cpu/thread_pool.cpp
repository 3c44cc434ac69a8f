#include "thread_pool.h"

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>

#if !defined(_WIN32)
#include <pthread.h>
#endif

namespace bigtri {
namespace {

struct Job {
  int64_t n;
  void (*body)(void*, int64_t);
  void* context;
  int helpers;  // workers that may still join
  std::atomic<int64_t> next{0};

  void work() {
    for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < n;) body(context, i);
  }
};

// A frame is several jobs in a row: a worker looks for the next one this often before it sleeps, some tens of microseconds.
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
};

ThreadPool::ThreadPool() : state_(new State) {}

ThreadPool& ThreadPool::instance() {
  static ThreadPool* pool = [] {
#if !defined(_WIN32)
    // A child has none of its parent's threads: it starts with a pool of its own.
    pthread_atfork(nullptr, nullptr, [] { instance().state_ = new State; });
#endif
    return new ThreadPool;
  }();
  return *pool;
}

void ThreadPool::run(int threads, int64_t n, void (*body)(void*, int64_t), void* context) {
  Job job;
  job.n = n;
  job.body = body;
  job.context = context;
  job.helpers = (int)(n < threads ? n : threads) - 1;
  State& s = *state_;
  bool shared = false;
  if (job.helpers > 0) {
    std::lock_guard<std::mutex> lock(s.mutex);
    if (!s.job.load()) {
      shared = true;
      try {
        for (; s.workers < job.helpers; ++s.workers) std::thread([&s] { s.worker(); }).detach();
      } catch (const std::system_error&) {  // no more threads to be had: fewer do
      }
      s.job.store(&job);
    }
  }
  if (!shared) {
    job.work();
    return;
  }
  s.job_posted.notify_all();
  job.work();
  std::unique_lock<std::mutex> lock(s.mutex);
  s.job.store(nullptr);  // whoever wakes now has missed it
  s.worker_left.wait(lock, [&] { return s.active == 0; });
}

}  // namespace bigtri
