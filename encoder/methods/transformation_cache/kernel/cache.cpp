// The transformation cache behind a plain C interface; mirrored in native.py.
#include "cache.h"

using namespace decogs;

namespace {
Cache& cache_of(void* handle) { return *static_cast<Cache*>(handle); }

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// Sizes of the structs of this interface, in the order in which Python's loader states them, and a 0 at the end.
const int64_t* decogs_sizes() {
    static const int64_t sizes[] = {sizeof(CacheShape), sizeof(AdamStep), sizeof(Trained), 0};
    return sizes;
}

void* decogs_cache_create(const CacheShape* shape, int threads) {
    return created([&] { return new Cache(*shape, threads); });
}

void decogs_cache_destroy(void* handle) { delete static_cast<Cache*>(handle); }

// `entries`: number of table entries read.
int decogs_cache_place(void* handle, int64_t count, const float* means, int64_t* entries) {
    return status_of([&] { *entries = cache_of(handle).place(count, means); });
}

void decogs_cache_entries(void* handle, int64_t* to) { cache_of(handle).entries(to); }

int decogs_cache_base(void* handle, int64_t count, const float* means, const float* quaternions) {
    return status_of([&] { cache_of(handle).base(count, means, quaternions); });
}

int decogs_cache_read(void* handle, const float* values) {
    return status_of([&] { cache_of(handle).read(values); });
}

int decogs_cache_moved(void* handle, const float* head, float* means, float* quaternions) {
    return status_of([&] { cache_of(handle).moved(head, means, quaternions); });
}

int decogs_cache_backward(void* handle, const float* v_means, const float* v_quaternions, float* v_base_means,
                          float* v_base_quaternions) {
    return status_of([&] { cache_of(handle).backward(v_means, v_quaternions, v_base_means, v_base_quaternions); });
}

int decogs_cache_gradients(void* handle, float* rows, float* head) {
    return status_of([&] { cache_of(handle).gradients(rows, head); });
}

int decogs_cache_step(void* handle, const AdamStep* adam, float rate, const Trained* rows, const Trained* head) {
    return status_of([&] { cache_of(handle).step(*adam, rate, *rows, *head); });
}
}
#pragma GCC visibility pop
