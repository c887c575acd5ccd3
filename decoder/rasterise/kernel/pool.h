// A pool of sleeping threads for independent tasks. Tasks write to separate memory, so that results do not depend on which
// thread runs which task.
//
// A thread that waits watches for a moment before it sleeps: to wake one takes 50 us, most of what a small picture's tasks take.
// It yields meanwhile, so that others who need the processor have it.
//
// An exception in a task (out of memory) ends the run; the first one is rethrown on the calling thread once all threads are
// idle. A forked child has none of its parent's threads; the pool starts new ones there.
//
// WebAssembly has neither threads nor exceptions here: serial.h says the same for it.
#pragma once

#ifdef __wasm__
#include "serial.h"
#else

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace decogs {

class Pool {
   public:
    explicit Pool(int threads) : crew_(new Crew(threads)), threads_(threads), process_(getpid()) {}
    Pool(const Pool&) = delete;
    Pool& operator=(const Pool&) = delete;
    ~Pool() {
        if (process_ == getpid()) delete crew_;  // a parent's threads cannot be joined
    }

    // Calls task(i) for every i in [0, count), on this thread and the pool's.
    void run(int count, const std::function<void(int)>& task) {
        if (process_ != getpid()) {
            crew_ = new Crew(threads_);
            process_ = getpid();
        }
        crew_->run(count, task);
    }

   private:
    static constexpr std::chrono::microseconds kWatch{100};

    class Crew {
       public:
        explicit Crew(int threads) {
            workers_.reserve(threads);
            try {
                for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
            } catch (const std::system_error&) {
                // The system refuses more threads: work with those that exist.
            }
        }
        ~Crew() {
            {
                std::lock_guard<std::mutex> lock(mutex_);
                stop_ = true;
            }
            wake_.notify_all();
            for (auto& worker : workers_) worker.join();
        }

        void run(int count, const std::function<void(int)>& task) {
            if (workers_.empty() || count <= 1) {
                for (int i = 0; i < count; ++i) task(i);
                return;
            }
            {
                std::lock_guard<std::mutex> lock(mutex_);
                task_ = &task;
                count_ = count;
                next_.store(0);
                failure_ = nullptr;
                wanted_ = busy_ = std::min(static_cast<int>(workers_.size()), count - 1);
            }
            for (int i = std::min(static_cast<int>(workers_.size()), count - 1); i > 0; --i) wake_.notify_one();
            drain(task, count);
            {
                std::lock_guard<std::mutex> lock(mutex_);
                busy_ -= wanted_.exchange(0);  // workers that still sleep may stay so: no task is left
            }
            watch_for([this] { return busy_ == 0; });
            std::unique_lock<std::mutex> lock(mutex_);
            done_.wait(lock, [this] { return busy_ == 0; });
            task_ = nullptr;
            if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
        }

       private:
        template <class Event>
        static void watch_for(const Event& has_happened) {
            using Clock = std::chrono::steady_clock;
            for (const auto end = Clock::now() + kWatch; !has_happened() && Clock::now() < end;) std::this_thread::yield();
        }
        void drain(const std::function<void(int)>& task, int count) {
            try {
                for (int i; (i = next_.fetch_add(1)) < count;) task(i);
            } catch (...) {
                next_.store(count);  // skip the remaining tasks
                std::lock_guard<std::mutex> lock(mutex_);
                if (!failure_) failure_ = std::current_exception();
            }
        }
        void work() {
            for (;;) {
                const std::function<void(int)>* task;
                int count;
                watch_for([this] { return stop_ || wanted_ > 0; });
                {
                    std::unique_lock<std::mutex> lock(mutex_);
                    wake_.wait(lock, [&] { return stop_ || wanted_ > 0; });
                    if (stop_) return;
                    --wanted_;
                    task = task_;
                    count = count_;
                }
                drain(*task, count);
                std::lock_guard<std::mutex> lock(mutex_);
                if (--busy_ == 0) done_.notify_one();
            }
        }

        std::vector<std::thread> workers_;
        std::mutex mutex_;
        std::condition_variable wake_, done_;
        const std::function<void(int)>* task_ = nullptr;
        std::exception_ptr failure_;
        std::atomic<int> next_{0};
        int count_ = 0;
        std::atomic<int> wanted_{0}, busy_{0};  // workers still to wake; workers awake or still to wake
        std::atomic<bool> stop_{false};
    };

    Crew* crew_;
    int threads_;
    pid_t process_;
};

// Status of a call of the C interface; mirrored in native.py and serial.h.
enum Status { kDone = 0, kCovered = 1, kNoMemory = 2 };

// Gaussians overlap so many tiles that the tile lists would exceed the limit.
struct TooManyPairs : std::exception {
    const char* what() const noexcept override { return "too many pairs of a tile and a Gaussian"; }
};
[[noreturn]] inline void refuse_pairs() { throw TooManyPairs(); }

// Turns exceptions into a status: the caller is not C++.
template <class Work>
int status_of(const Work& work) noexcept {
    try {
        work();
    } catch (const TooManyPairs&) {
        return kCovered;
    } catch (...) {  // allocation is all that can fail here
        return kNoMemory;
    }
    return kDone;
}

// The object that `make` creates; null if memory runs out.
template <class Make>
void* created(const Make& make) noexcept {
    try {
        return make();
    } catch (...) {
        return nullptr;
    }
}

}  // namespace decogs
#endif
