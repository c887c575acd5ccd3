// RGB bytes from planes of YCbCr, in integers: the same bits on every machine, and no rounding but the last.
#include <algorithm>
#include <cstdint>
#include <memory>
#include <new>
#if defined(__x86_64__)
#include <cpuid.h>
#endif

// Counters are of 64 bits: Python's compiler flags let integers wrap (-fwrapv), and loops over an int that may are not
// turned into vectors.
namespace decogs {

// A picture as its decoder left it (formats/colours/ycbcr.py has the same). Strides are in samples.
struct Samples {
    const void* luma;
    const void* blue;
    const void* red;
    int64_t luma_stride;
    int64_t blue_stride;
    int64_t red_stride;
    int32_t width;
    int32_t height;
    int32_t wide;            // 1: all samples are of 16 bits
    int32_t halved_columns;  // 1: every other column has chroma
    int32_t halved_rows;
    int32_t on_column;  // 1: the first chroma sample lies on the first column, 0: half a pixel further
    int32_t on_row;
    int32_t matrix[3][4];  // of luma, 16 Cb, 16 Cr, and 1; in 1 / 2^kBits
};

constexpr int kBits = 20;
constexpr int64_t kBlock = 256;

// Where a luma sample lies between chroma samples: the nearer one, the other one, and how much of each, in quarters.
struct Between {
    int near, far, near_share, far_share;
};

inline Between between(int at, int count, bool halved, bool on_first) {
    if (!halved) return {at, at, 4, 0};
    const int near = at / 2;
    if (on_first) return at % 2 ? Between{near, std::min(near + 1, count - 1), 2, 2} : Between{near, near, 4, 0};
    return {near, at % 2 ? std::min(near + 1, count - 1) : std::max(near - 1, 0), 3, 1};
}

// One row of chroma at every column of luma, in sixteenths. `row` has room for `count` samples.
template <typename Sample>
void chroma_row(const Samples& p, const Sample* plane, int64_t stride, int y, int32_t* row, int32_t* full) {
    const int64_t count = p.halved_columns ? (p.width + 1) / 2 : p.width;
    const Between lines = between(y, p.halved_rows ? (p.height + 1) / 2 : p.height, p.halved_rows, p.on_row);
    const Sample* near = plane + lines.near * stride;
    const Sample* far = plane + lines.far * stride;
    for (int64_t x = 0; x < count; ++x) row[x] = lines.near_share * near[x] + lines.far_share * far[x];
    if (!p.halved_columns) {
        for (int64_t x = 0; x < count; ++x) full[x] = 4 * row[x];
        return;
    }
    row[count] = row[count - 1];
    if (p.on_column) {
        for (int64_t x = 0; x < count; ++x) {
            full[2 * x] = 4 * row[x];
            full[2 * x + 1] = 2 * (row[x] + row[x + 1]);
        }
        return;
    }
    row[-1] = row[0];
    for (int64_t x = 0; x < count; ++x) {
        full[2 * x] = 3 * row[x] + row[x - 1];
        full[2 * x + 1] = 3 * row[x] + row[x + 1];
    }
}

// Channel by channel, and then side by side: both loops are ones that compilers turn into vectors.
template <typename Sample>
void rgb_row(const Samples& p, const Sample* luma, const int32_t* blue, const int32_t* red, uint8_t* rgb) {
    uint8_t channels[3][kBlock];
    for (int64_t begin = 0; begin < p.width; begin += kBlock) {
        const int64_t count = std::min(kBlock, p.width - begin);
        for (int c = 0; c < 3; ++c) {
            const int32_t of_luma = p.matrix[c][0], of_blue = p.matrix[c][1], of_red = p.matrix[c][2];
            const int32_t added = p.matrix[c][3] + (1 << (kBits - 1));
            for (int64_t i = 0; i < count; ++i) {
                const int64_t x = begin + i;
                const int32_t value = (of_luma * luma[x] + of_blue * blue[x] + of_red * red[x] + added) >> kBits;
                channels[c][i] = static_cast<uint8_t>(std::min(std::max(value, 0), 255));
            }
        }
        uint8_t* out = rgb + 3 * begin;
        for (int64_t i = 0; i < count; ++i) {
            out[3 * i] = channels[0][i];
            out[3 * i + 1] = channels[1][i];
            out[3 * i + 2] = channels[2][i];
        }
    }
}

template <typename Sample>
void convert(const Samples& p, uint8_t* rgb, int32_t* rows) {
    // A row has one sample more on either side; a full one may have one column more than luma.
    const int64_t room = p.width + 3;
    int32_t *narrow = rows + 1, *blue = rows + room, *red = rows + 2 * room;
    for (int y = 0; y < p.height; ++y) {
        chroma_row(p, static_cast<const Sample*>(p.blue), p.blue_stride, y, narrow, blue);
        chroma_row(p, static_cast<const Sample*>(p.red), p.red_stride, y, narrow, red);
        rgb_row(p, static_cast<const Sample*>(p.luma) + y * p.luma_stride, blue, red, rgb + int64_t{3} * y * p.width);
    }
}

// Asked of the processor, and of the system, which must keep the wide registers when it changes threads. For the
// compilers' own __builtin_cpu_supports a library is needed that not every one of them brings.
inline int widest_set() {
#if defined(__x86_64__)
    constexpr unsigned kFirst = bit_OSXSAVE | bit_FMA, kAvx2 = bit_AVX2 | bit_BMI2;
    constexpr unsigned kAvx512 = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    constexpr unsigned kWide = 0x06, kWidest = 0xe6;  // registers of 256 and of 512 bits
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & kFirst) != kFirst) return 0;
    unsigned kept, high;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    if ((kept & kWide) != kWide || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & kAvx2) != kAvx2) return 0;
    return (kept & kWidest) == kWidest && (b & kAvx512) == kAvx512 ? 2 : 1;
#else
    return 0;
#endif
}

}  // namespace decogs

#pragma GCC visibility push(default)
extern "C" {

// The best build for this processor: 2 AVX-512, 1 AVX2, 0 base. The base build answers, since every machine can load it.
int decogs_instruction_set() { return decogs::widest_set(); }

// Sizes of the structs of this interface, in the order in which Python's loader states them, and a 0 at the end.
const int64_t* decogs_sizes() {
    static const int64_t sizes[] = {sizeof(decogs::Samples), 0};
    return sizes;
}

// 0, or 1 when there is no memory. `rgb`: height x width x 3.
int decogs_rgb_of_ycbcr(const decogs::Samples* samples, uint8_t* rgb) {
    const std::unique_ptr<int32_t[]> rows(new (std::nothrow) int32_t[3 * (int64_t{samples->width} + 3)]);
    if (!rows) return 1;
    if (samples->wide) {
        decogs::convert<uint16_t>(*samples, rgb, rows.get());
    } else {
        decogs::convert<uint8_t>(*samples, rgb, rows.get());
    }
    return 0;
}

}  // extern "C"
#pragma GCC visibility pop
