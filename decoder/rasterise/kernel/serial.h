// What pool.h has, for WebAssembly: tasks run one after the other, and what would throw there traps.
//
// A trap leaves the instance as it stood; its owner asks `failure` what happened and starts a new one.
#pragma once

#include <functional>

namespace decogs {

enum Status { kDone = 0, kCovered = 1, kNoMemory = 2 };

// What ended the instance, should it trap: memory is all that can run out unless someone says otherwise.
inline int failure = kNoMemory;

[[noreturn]] inline void refuse_pairs() {
    failure = kCovered;
    __builtin_trap();
}

class Pool {
   public:
    explicit Pool(int) {}
    Pool(const Pool&) = delete;
    Pool& operator=(const Pool&) = delete;

    void run(int count, const std::function<void(int)>& task) {
        for (int i = 0; i < count; ++i) task(i);
    }
};

template <class Work>
int status_of(const Work& work) noexcept {
    work();
    return kDone;
}

template <class Make>
void* created(const Make& make) noexcept {
    return make();
}

}  // namespace decogs
