// A small pool of sleeping threads. Work is a number of independent tasks; which thread runs which task never changes
// a result, because tasks write to places of their own.
//
// An exception in a task (memory that runs out) ends the run: the first one is thrown again on the calling thread once no
// thread works any more. A forked child has none of its parent's threads; the pool starts its own there.
#pragma once

#include <unistd.h>

#include <algorithm>
#include <atomic>
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
        if (process_ == getpid()) delete crew_;  // the threads of a parent cannot be waited for
    }

    int threads() const { return threads_; }

    // Calls task(i) for every i in [0, count), on this thread and the sleeping ones.
    void run(int count, const std::function<void(int)>& task) {
        if (process_ != getpid()) {
            crew_ = new Crew(threads_);
            process_ = getpid();
        }
        crew_->run(count, task);
    }

   private:
    class Crew {
       public:
        explicit Crew(int threads) {
            workers_.reserve(threads);
            try {
                for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
            } catch (const std::system_error&) {
                // No more threads are to be had: those that are there do the work.
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
            std::unique_lock<std::mutex> lock(mutex_);
            busy_ -= std::exchange(wanted_, 0);  // who has not woken yet may sleep on: nothing is left to begin
            done_.wait(lock, [this] { return busy_ == 0; });
            task_ = nullptr;
            if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
        }

       private:
        void drain(const std::function<void(int)>& task, int count) {
            try {
                for (int i; (i = next_.fetch_add(1)) < count;) task(i);
            } catch (...) {
                next_.store(count);  // what is left need not be begun
                std::lock_guard<std::mutex> lock(mutex_);
                if (!failure_) failure_ = std::current_exception();
            }
        }
        void work() {
            for (;;) {
                const std::function<void(int)>* task;
                int count;
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
        int count_ = 0, wanted_ = 0, busy_ = 0;  // workers that are still to wake; those that are, or still to wake
        bool stop_ = false;
    };

    Crew* crew_;
    int threads_;
    pid_t process_;
};

// What a call of the C interface says of its work; mirrored in native.py.
enum Status { kDone = 0, kCovered = 1, kNoMemory = 2 };

// The picture is covered so many times that its tile lists would not fit.
struct TooManyPairs : std::exception {
    const char* what() const noexcept override { return "too many pairs of a tile and a Gaussian"; }
};

// Does the work, and lets no exception out: the caller is not C++.
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

// What `make` creates, or null when memory is short.
template <class Make>
void* created(const Make& make) noexcept {
    try {
        return make();
    } catch (...) {
        return nullptr;
    }
}

}  // namespace decogs
