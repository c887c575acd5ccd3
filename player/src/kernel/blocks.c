/**
 * Blocks of bytes that are read from the first to the last: checksums (formats/SPEC.md section 3), and integers that are
 * told by their differences (section 6, prediction modes 1 and 3). `running` is what one batch leaves to the next.
 */
#include "kernel.h"

#define CHUNK 65536

static uint8_t block_bytes[CHUNK];
static int32_t block_columns[3 * BATCH];
static uint32_t tables[8][256];
static uint64_t running;

EXPORT(block_bytes_at) uint8_t *block_bytes_at(void) { return block_bytes; }
EXPORT(block_columns_at) int32_t *block_columns_at(void) { return block_columns; }
EXPORT(block_begin) void block_begin(void) { running = 0; }

/** Table k, entry b: the checksum of byte b followed by k zero bytes. */
static void make_tables(void) {
    for (uint32_t byte = 0; byte < 256; byte++) {
        uint32_t rest = byte;
        for (int bit = 0; bit < 8; bit++) rest = rest >> 1 ^ (0xedb88320u & -(rest & 1));
        tables[0][byte] = rest;
    }
    for (uint32_t k = 1; k < 8; k++) {
        for (uint32_t byte = 0; byte < 256; byte++) {
            const uint32_t before = tables[k - 1][byte];
            tables[k][byte] = tables[0][before & 255] ^ before >> 8;
        }
    }
}

/** CRC-32 of ISO 3309 and zlib, eight bytes a step: goes on with `length` more bytes from what those before came to. */
EXPORT(crc32) uint32_t crc32(uint32_t before, uint32_t length) {
    if (tables[0][1] == 0) make_tables();
    uint32_t crc = ~before, i = 0;
    for (; i + 8 <= length; i += 8) {
        const uint8_t *b = block_bytes + i;
        crc ^= b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
        crc = tables[7][crc & 255] ^ tables[6][crc >> 8 & 255] ^ tables[5][crc >> 16 & 255] ^ tables[4][crc >> 24] ^
              tables[3][b[4]] ^ tables[2][b[5]] ^ tables[1][b[6]] ^ tables[0][b[7]];
    }
    for (; i < length; i++) crc = tables[0][(crc ^ block_bytes[i]) & 255] ^ crc >> 8;
    return ~crc;
}

/** A row's number in planes of `BATCH` bytes, lowest first. */
static uint64_t number_in(uint32_t planes, uint32_t row) {
    uint64_t number = 0;
    for (uint32_t plane = planes; plane-- > 0;) number = number << 8 | block_bytes[BATCH * plane + row];
    return number;
}

/** A column of integers, each of which is the sum of all up to it. */
EXPORT(sums) void sums(uint32_t planes, uint32_t rows) {
    uint32_t sum = (uint32_t)running;
    for (uint32_t i = 0; i < rows; i++) {
        const uint32_t code = (uint32_t)number_in(planes, i);
        sum += code >> 1 ^ -(code & 1);
        block_columns[i] = (int32_t)sum;
    }
    running = sum;
}

/** Numbers from one on. */
EXPORT(count_up) void count_up(uint32_t from, uint32_t rows) {
    for (uint32_t i = 0; i < rows; i++) block_columns[i] = (int32_t)(from + i);
}

/** Bits 0, 3, ..., 60 side by side. */
static uint32_t every_third(uint64_t bits) {
    bits &= 0x1249249249249249u;
    bits = (bits | bits >> 2) & 0x10c30c30c30c30c3u;
    bits = (bits | bits >> 4) & 0x100f00f00f00f00fu;
    bits = (bits | bits >> 8) & 0x001f0000ff0000ffu;
    bits = (bits | bits >> 16) & 0x001f00000000ffffu;
    return (uint32_t)((bits | bits >> 32) & 0x1fffff);
}

/** Columns x, y, z of positions from differences of Morton codes, constants added; 0 where a code is 2^63 or above. */
EXPORT(morton) uint32_t morton(uint32_t planes, uint32_t rows, uint32_t x, uint32_t y, uint32_t z) {
    for (uint32_t i = 0; i < rows; i++) {
        const uint64_t difference = number_in(planes, i);
        running += difference;
        // Both were below 2^63, so that the sum has not passed 2^64.
        if ((difference | running) >> 63) return 0;
        block_columns[i] = (int32_t)(every_third(running) + x);
        block_columns[BATCH + i] = (int32_t)(every_third(running >> 1) + y);
        block_columns[2 * BATCH + i] = (int32_t)(every_third(running >> 2) + z);
    }
    return 1;
}
