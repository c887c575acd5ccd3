// CUDA's blocks and threads on one thread of the processor: kernels run in front of any debugger, without a GPU.
//
// Every thread of a block is a fiber. It runs until it waits for its warp or its block; those that wait go on when all of
// them do. A warp whose lanes wait for different things is a mistake that a GPU would hang on, and ends the process.
#pragma once

#include <ucontext.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#define __global__
#define __device__
#define __shared__ static  // blocks run one after the other
#define __constant__ static const
#define __launch_bounds__(...)

struct Index3 {
    unsigned x, y, z;
};
inline Index3 threadIdx, blockIdx, blockDim, gridDim;

namespace emulation {

enum State { kReady, kAtWarp, kAtBlock, kDone };
struct Fiber {
    ucontext_t context;
    void* stack_pointer = nullptr;
    State state = kDone;
    int calls = 0;  // of collective operations of its warp
    std::unique_ptr<char[]> stack;
};
constexpr int kLanesOfWarp = 32, kStack = 1 << 17;
inline std::vector<Fiber> fibers;
inline Fiber main_fiber;
inline unsigned current;
inline uint64_t slots[64][2][kLanesOfWarp];  // by warp: what lanes hand to each other, this time and next
inline int block_votes[2], block_calls;
inline const std::pair<void (*)(void*), void*>* work;
extern "C" int decogs_backwards;
int decogs_backwards = 0;  // whether blocks, warps and lanes come in the opposite order
inline unsigned turn(unsigned i, unsigned count) { return decogs_backwards ? count - 1 - i : i; }

#if defined(__x86_64__)
// Swaps stacks; the registers that a call must keep are on them. swapcontext asks the system each time.
extern "C" void decogs_switch(void** from, void* to);
asm(R"(
.text
decogs_switch:
    pushq %rbp
    pushq %rbx
    pushq %r12
    pushq %r13
    pushq %r14
    pushq %r15
    movq %rsp, (%rdi)
    movq %rsi, %rsp
    popq %r15
    popq %r14
    popq %r13
    popq %r12
    popq %rbx
    popq %rbp
    ret
)");
inline void go(Fiber& from, Fiber& to) { decogs_switch(&from.stack_pointer, to.stack_pointer); }
inline void prepare(Fiber& fiber, void (*entry)()) {
    void** top = reinterpret_cast<void**>((reinterpret_cast<uintptr_t>(fiber.stack.get() + kStack) & ~uintptr_t{15}) - 16);
    top[0] = reinterpret_cast<void*>(entry);
    top[1] = nullptr;
    fiber.stack_pointer = top - 6;
}
#else
inline void go(Fiber& from, Fiber& to) { swapcontext(&from.context, &to.context); }
inline void prepare(Fiber& fiber, void (*entry)()) {
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack.get();
    fiber.context.uc_stack.ss_size = kStack;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, entry, 0);
}
#endif

inline void leave(State state) {
    fibers[current].state = state;
    go(fibers[current], main_fiber);
    threadIdx.x = current;
}

inline void entry() {
    work->first(work->second);
    for (;;) leave(kDone);
}

// What the warp's lanes gave in this call, once all have.
inline const uint64_t* exchange(uint64_t value) {
    Fiber& own = fibers[current];
    uint64_t* all = slots[current / kLanesOfWarp][own.calls++ % 2];
    all[current % kLanesOfWarp] = value;
    leave(kAtWarp);
    return all;
}

inline void run_block(unsigned threads) {
    if (fibers.size() < threads) fibers.resize(threads);
    block_votes[0] = block_votes[1] = block_calls = 0;
    for (unsigned i = 0; i < threads; ++i) {
        if (!fibers[i].stack) fibers[i].stack.reset(new char[kStack]);
        fibers[i].state = kReady;
        fibers[i].calls = 0;
        prepare(fibers[i], entry);
    }
    for (bool working = true; working;) {
        working = false;
        for (unsigned warp = 0; warp < threads / kLanesOfWarp; ++warp)
            for (bool again = true; again;) {
                const unsigned first = turn(warp, threads / kLanesOfWarp) * kLanesOfWarp;
                int waiting[4] = {0};
                for (unsigned lane = 0; lane < kLanesOfWarp; ++lane) {
                    const unsigned i = first + turn(lane, kLanesOfWarp);
                    if (fibers[i].state == kReady) {
                        current = threadIdx.x = i;
                        go(main_fiber, fibers[i]);
                    }
                    ++waiting[fibers[i].state];
                }
                if (waiting[kAtWarp] && waiting[kAtWarp] != kLanesOfWarp) {
                    std::fprintf(stderr, "lanes of a warp wait for different things\n");
                    std::abort();
                }
                again = waiting[kAtWarp] > 0;
                working |= waiting[kAtBlock] > 0;
                for (unsigned i = first; again && i < first + kLanesOfWarp; ++i) fibers[i].state = kReady;
            }
        for (unsigned i = 0; i < threads; ++i)
            if (fibers[i].state == kAtBlock) fibers[i].state = kReady;
        block_votes[++block_calls % 2] = 0;
    }
}

template <class... A, size_t... kIndex>
void call(void (*kernel)(A...), void** arguments, std::index_sequence<kIndex...>) {
    kernel(*static_cast<std::remove_reference_t<A>*>(arguments[kIndex])...);
}
template <class... A>
void launch(void (*kernel)(A...), unsigned x, unsigned y, unsigned z, unsigned threads, void** arguments) {
    struct Work {
        void (*kernel)(A...);
        void** arguments;
    } given{kernel, arguments};
    const auto run = [](void* what) {
        Work& w = *static_cast<Work*>(what);
        call(w.kernel, w.arguments, std::index_sequence_for<A...>());
    };
    const std::pair<void (*)(void*), void*> now(run, &given);
    work = &now;
    gridDim = {x, y, z};
    blockDim = {threads, 1, 1};
    threadIdx = {0, 0, 0};
    for (unsigned k = 0; k < z; ++k)
        for (unsigned j = 0; j < y; ++j)
            for (unsigned i = 0; i < x; ++i) {
                blockIdx = {turn(i, x), turn(j, y), turn(k, z)};
                run_block(threads);
            }
}

}  // namespace emulation

inline void __syncthreads() { emulation::leave(emulation::kAtBlock); }
inline int __syncthreads_or(int vote) {
    int& votes = emulation::block_votes[emulation::block_calls % 2];
    votes |= vote;
    __syncthreads();
    return votes;
}
inline unsigned __ballot_sync(unsigned, bool vote) {
    const uint64_t* all = emulation::exchange(vote);
    unsigned bits = 0;
    for (int i = 0; i < emulation::kLanesOfWarp; ++i) bits |= static_cast<unsigned>(all[i]) << i;
    return bits;
}
template <class T>
T __shfl_xor_sync(unsigned, T value, int mask) {
    uint64_t given = 0;
    std::memcpy(&given, &value, sizeof value);
    const uint64_t* all = emulation::exchange(given);
    T taken;
    std::memcpy(&taken, &all[emulation::current % emulation::kLanesOfWarp ^ mask], sizeof taken);
    return taken;
}
inline int atomicAdd(int* at, int more) { return std::exchange(*at, *at + more); }
inline int atomicSub(int* at, int less) { return std::exchange(*at, *at - less); }
inline int atomicMin(int* at, int other) { return std::exchange(*at, std::min(*at, other)); }
inline int atomicMax(int* at, int other) { return std::exchange(*at, std::max(*at, other)); }
inline int __popc(unsigned bits) { return __builtin_popcount(bits); }
inline int __ffs(unsigned bits) { return __builtin_ffs(static_cast<int>(bits)); }
inline int __clz(unsigned bits) { return __builtin_clz(bits); }
inline unsigned __float_as_uint(float value) {
    unsigned bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}
