// The thread pool by itself: test_thread_pool.py compiles this, also with sanitizers, and runs one scenario a process.
// A scenario that fails says what is wrong and ends the process; one that hangs is ended by its alarm.

#include "parallel.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace {

// Set by a thread before it does what may not allocate, or what is to stop where it first allocates.
enum class Allocation { kFree, kForbidden, kParked };
thread_local Allocation allocation = Allocation::kFree;
std::atomic<bool> parked{false}, released{false};

}  // namespace

// Not inlined: gcc, seeing one of them and not the other, would warn of a mismatch.
__attribute__((noinline)) void* operator new(size_t size) {
  if (allocation == Allocation::kForbidden) {
    fputs("memory was allocated in a fork handler\n", stderr);
    _exit(1);
  }
  if (allocation == Allocation::kParked) {
    allocation = Allocation::kFree;
    parked = true;
    while (!released) std::this_thread::yield();
  }
  if (void* memory = malloc(size)) return memory;
  throw std::bad_alloc();
}

__attribute__((noinline)) void operator delete(void* memory) noexcept { free(memory); }
__attribute__((noinline)) void operator delete(void* memory, size_t) noexcept { free(memory); }

namespace {

using bigtri::Parallel;

constexpr int64_t kEndless = (int64_t)1 << 50;  // indices: more than any scenario lives to see
constexpr unsigned kLimit = 60;  // s, for a scenario

void require(bool holds, const char* what) {
  if (holds) return;
  fprintf(stderr, "not so: %s\n", what);
  _exit(1);
}

template <class Condition>
bool comes_true(Condition condition) {
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > limit) return false;
    std::this_thread::yield();
  }
  return true;
}

// Whether `threads` threads work at once: every body waits until all have begun.
bool work_together(int threads) {
  std::atomic<int> begun{0}, met{0};
  Parallel{threads}(threads, [&](int64_t) {
    ++begun;
    met += comes_true([&] { return begun == threads; });
  });
  return met == threads;
}

void require_each_index_once(int threads, int64_t n) {
  const std::unique_ptr<std::atomic<int>[]> calls(new std::atomic<int>[(size_t)n + 1]());
  Parallel{threads}(n, [&](int64_t i) { ++calls[i]; });
  for (int64_t i = 0; i < n; ++i) require(calls[i] == 1, "every index is called once");
  require(calls[n] == 0, "no index beyond the last is called");
}

// What the call throws, or "".
template <class Body>
std::string thrown_by(int threads, int64_t n, Body body) {
  try {
    Parallel{threads}(n, body);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

void require_usable() {
  require(work_together(4), "workers still join a job");
  require_each_index_once(4, 10000);
}

void each_index_once() {
  for (int threads : {1, 2, 3, 8}) {
    for (int64_t n : {0, 1, 2, 7, 20000}) require_each_index_once(threads, n);
    require(work_together(threads), "as many threads as asked for work together");
  }
}

// The others are still inside the job when one thread throws, the caller or a worker: none may be when the caller goes
// on.
void throw_on(bool caller_throws) {
  for (int round = 0; round < 20; ++round) {
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<int> inside{0};
    std::atomic<bool> throwing{false};
    const std::string said = thrown_by(3, kEndless, [&](int64_t) {
      const bool throws = (std::this_thread::get_id() == caller) == caller_throws;
      ++inside;
      if (throws && comes_true([&] { return inside >= 2 || throwing; }) && !throwing.exchange(true)) {
        --inside;
        throw std::runtime_error("thrown by a body");
      }
      comes_true([&] { return throwing.load(); });
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      --inside;
    });
    require(inside == 0, "every thread has left the job when its exception arrives");
    require(said == "thrown by a body", "the exception arrives on the caller");
    require_usable();
  }
}

void all_throw() {
  for (int round = 0; round < 20; ++round) {
    std::atomic<int> begun{0};
    const std::string said = thrown_by(4, kEndless, [&](int64_t) {
      const int me = begun++;
      comes_true([&] { return begun >= 4; });
      throw std::runtime_error(std::to_string(me));
    });
    require(said.size() == 1 && said[0] >= '0' && said[0] < '4', "one of the exceptions arrives");
    require(begun == 4, "no thread starts another index after its own threw");
  }
  require_usable();
}

void throw_on_one_thread() {
  int64_t started = 0;
  const std::string said = thrown_by(1, 100, [&](int64_t i) {
    ++started;
    if (i == 7) throw std::runtime_error("thrown by a body");
  });
  require(said == "thrown by a body", "the exception arrives");
  require(started == 8, "no index is started after one that throws");
  require_usable();
}

void nested() {
  std::atomic<int64_t> sum{0}, caught{0};
  Parallel{4}(50, [&](int64_t outer) {
    Parallel{4}(100, [&](int64_t inner) { sum += 100 * outer + inner; });
    caught += !thrown_by(4, 100, [&](int64_t i) {
                 if (i == 99) throw std::runtime_error("thrown by an inner body");
               }).empty();
  });
  require(sum == 4999 * 5000 / 2, "every inner index is called once");
  require(caught == 50, "an inner exception arrives where the inner call was made");
  const auto throws = [](int64_t) { throw std::runtime_error("thrown by an inner body"); };
  const std::string said = thrown_by(4, kEndless, [&](int64_t) { Parallel{4}(kEndless, throws); });
  require(said == "thrown by an inner body", "an exception leaves the outer call too");
  require_usable();
}

// The caller has run out of indices and waits for its workers; one of them only now makes a call of its own.
void nested_in_the_last_body() {
  const std::thread::id caller = std::this_thread::get_id();
  std::atomic<int> begun{0};
  std::atomic<int64_t> sum{0};
  Parallel{2}(2, [&](int64_t) {
    ++begun;
    require(comes_true([&] { return begun == 2; }), "a worker joins");
    if (std::this_thread::get_id() == caller) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    Parallel{4}(100, [&](int64_t inner) { sum += inner; });
  });
  require(sum == 4950, "every inner index is called once");
  require_usable();
}

// Where loops are timed, one thread takes all indices, each for the thread that would be free first.
void load() {
  constexpr int64_t kMillisecond = 1000000;
  bigtri::Load load;
  std::vector<int64_t> slots;
  const std::thread::id caller = std::this_thread::get_id();
  const bigtri::Parallel timed{2, &load};
  for (int loop = 0; loop < 2; ++loop)
    timed.with_slots(4, [&](int64_t i, int64_t slot) {
      require(std::this_thread::get_id() == caller, "one thread does all the work");
      slots.push_back(slot);
      const int64_t end = bigtri::thread_time() + (i == 0 ? 20 : 5) * kMillisecond;
      while (bigtri::thread_time() < end) {
      }
    });
  require(slots == std::vector<int64_t>{0, 1, 1, 1, 0, 1, 1, 1}, "the thread that is free first takes the next index");
  require(load.all >= 70 * kMillisecond, "all work counts");
  require(load.longest >= 40 * kMillisecond && load.longest <= load.all - 30 * kMillisecond,
          "the longest thread of each loop counts");
  int64_t calls = 0;
  timed(1000, [&](int64_t) { ++calls; });
  require(calls == 1000, "every index is called once");
}

void several_callers() {
  std::vector<std::thread> callers;
  for (int c = 0; c < 4; ++c) {
    callers.emplace_back([c] {
      for (int round = 0; round < 200; ++round) {
        require_each_index_once(3, 100);
        const std::string mine = "thrown for caller " + std::to_string(c);
        const std::string said = thrown_by(3, kEndless, [&](int64_t i) {
          if (i >= 20) throw std::runtime_error(mine);
        });
        require(said == mine, "a caller gets its own exception");
      }
    });
  }
  for (std::thread& caller : callers) caller.join();
  require_usable();
}

#if defined(__x86_64__)
constexpr unsigned kBitsMode = 0x1f80, kCallersMode = 0x9f80;  // MXCSR; the caller's flushes to zero

// Every thread has its own mode again after a body has returned or thrown.
void float_mode() {
  std::atomic<int> begun{0}, right{0};
  const auto body = [](void* context, int64_t i) {
    auto& [begun, right] = *static_cast<std::pair<std::atomic<int>*, std::atomic<int>*>*>(context);
    ++*begun;
    const bool together = comes_true([begun = begun] { return *begun == 3; });
    _mm_setcsr(kCallersMode);
    unsigned inside = 0;
    const std::string said = thrown_by(1, 1, [&](int64_t) {
      inside = _mm_getcsr();
      if (i % 2 == 0) throw std::runtime_error("thrown by a body");
    });
    *right += together && inside == kBitsMode && said.empty() == (i % 2 == 1) && _mm_getcsr() == kCallersMode;
    _mm_setcsr(kBitsMode);
  };
  std::pair<std::atomic<int>*, std::atomic<int>*> counts{&begun, &right};
  bigtri::ThreadPool::instance().run(3, 3, body, &counts);
  require(right == 3, "the mode is set inside a body and put back behind it");
}

// Waits for a value that is about to come: a call to the system would empty the buffers of streaming stores.
void spin_until(const std::atomic<int>& value, int expected) {
  for (int spins = 0; value.load(std::memory_order_acquire) != expected; ++spins) {
    if (spins < 10000) {
      _mm_pause();
    } else {
      std::this_thread::yield();
    }
  }
}

// Of a call on one thread, where no lock orders them. The cells are far apart: a full buffer would empty itself.
void streaming_stores() {
  constexpr int kRounds = 4000, kCells = 8;
  constexpr int64_t kStride = 512;
  alignas(4096) static long long memory[kCells * kStride];
  alignas(128) static std::atomic<int> told{0};
  alignas(128) static std::atomic<int> seen{0};
  std::thread reader([] {
    for (int round = 1; round <= kRounds; ++round) {
      spin_until(told, round);
      for (int c = 0; c < kCells; ++c) {
        const long long cell = *(volatile long long*)&memory[c * kStride];
        require(cell == round, "what a call has stored can be seen after it");
      }
      seen.store(round, std::memory_order_release);
    }
  });
  const auto body = [](void* context, int64_t i) {
    long long* cell = &memory[i * kStride];
    _mm_stream_si64(cell, *static_cast<int*>(context));
  };
  for (int round = 1; round <= kRounds; ++round) {
    bigtri::ThreadPool::instance().run(1, kCells, body, &round);
    told.store(round, std::memory_order_release);
    spin_until(seen, round);
  }
  reader.join();
}
#endif

// Forks; the child has to be able to run a job on several threads.
void require_child_works() {
  const pid_t child = fork();
  if (child == 0) {
    alarm(20);
    allocation = Allocation::kFree;
    require_usable();
    _exit(0);
  }
  allocation = Allocation::kFree;
  int status = -1;
  require(child > 0 && waitpid(child, &status, 0) == child, "a child can be made");
  require(status == 0, "a forked child runs a parallel job");
}

void fork_handler_allocates_nothing() {
  require_usable();
  for (int round = 0; round < 5; ++round) {
    allocation = Allocation::kForbidden;
    require_child_works();
  }
  require_usable();
}

// Another thread is in the middle of the process's first job.
void fork_amid_first_job() {
  std::thread other([] {
    const auto body = [](void*, int64_t) {};
    allocation = Allocation::kParked;
    bigtri::ThreadPool::instance().run(2, 2, body, nullptr);
  });
  require(comes_true([] { return parked.load(); }), "the first job allocates");
  require_child_works();
  released = true;
  other.join();
  require_usable();
}

void fork_while_others_work() {
  std::atomic<bool> stop{false};
  std::vector<std::thread> others;
  for (int t = 0; t < 3; ++t) {
    others.emplace_back([&] {
      while (!stop) Parallel{3}(64, [](int64_t i) { std::vector<char>((size_t)(1000 * i + 1)); });
    });
  }
  for (int round = 0; round < 30; ++round) require_child_works();
  stop = true;
  for (std::thread& other : others) other.join();
  require_usable();
}

struct Scenario {
  const char* name;
  void (*play)();
};

constexpr Scenario kScenarios[] = {
    {"each_index_once", each_index_once},
    {"throw_on_caller", [] { throw_on(true); }},
    {"throw_on_worker", [] { throw_on(false); }},
    {"all_throw", all_throw},
    {"throw_on_one_thread", throw_on_one_thread},
    {"nested", nested},
    {"nested_in_the_last_body", nested_in_the_last_body},
    {"several_callers", several_callers},
    {"load", load},
#if defined(__x86_64__)
    {"float_mode", float_mode},
    {"streaming_stores", streaming_stores},
#endif
    {"fork_handler_allocates_nothing", fork_handler_allocates_nothing},
    {"fork_amid_first_job", fork_amid_first_job},
    {"fork_while_others_work", fork_while_others_work},
};

}  // namespace

// Plays the scenario named, or lists them.
int main(int count, char** arguments) {
  for (const Scenario& scenario : kScenarios) {
    if (count < 2) {
      puts(scenario.name);
    } else if (!strcmp(scenario.name, arguments[1])) {
      alarm(kLimit);
      scenario.play();
      return 0;
    }
  }
  return count < 2 ? 0 : 2;
}
