// A small pool of sleeping threads. Work is a number of independent tasks; which thread runs which task never changes
// a result, because tasks write to places of their own.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace decogs {

class Pool {
   public:
    explicit Pool(int threads) {
        for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
    }
    Pool(const Pool&) = delete;
    Pool& operator=(const Pool&) = delete;
    ~Pool() {
        {
            std::lock_guard<std::mutex> lock(mutex_);
            stop_ = true;
        }
        wake_.notify_all();
        for (auto& worker : workers_) worker.join();
    }

    int threads() const { return static_cast<int>(workers_.size()) + 1; }

    // Calls task(i) for every i in [0, count), on this thread and the sleeping ones.
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
            busy_ = static_cast<int>(workers_.size());
            ++round_;
        }
        wake_.notify_all();
        drain(task, count);
        std::unique_lock<std::mutex> lock(mutex_);
        done_.wait(lock, [this] { return busy_ == 0; });
        task_ = nullptr;
    }

   private:
    void drain(const std::function<void(int)>& task, int count) {
        for (int i; (i = next_.fetch_add(1)) < count;) task(i);
    }
    void work() {
        long seen = 0;
        for (;;) {
            const std::function<void(int)>* task;
            int count;
            {
                std::unique_lock<std::mutex> lock(mutex_);
                wake_.wait(lock, [&] { return stop_ || round_ != seen; });
                if (stop_) return;
                seen = round_;
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
    std::atomic<int> next_{0};
    int count_ = 0, busy_ = 0;
    long round_ = 0;
    bool stop_ = false;
};

}  // namespace decogs
