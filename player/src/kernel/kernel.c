/**
 * The player's inner loops: integers, digest and floats of a batch of Gaussians (formats/SPEC.md sections 5 and 7).
 *
 * In C for its products of 64 bits, which JavaScript has not, and since a scene's first frame is decoded before JavaScript is
 * optimised. An instance's memory holds one state, place after place. It grows once, in `reserve`, before anything looks at
 * it. What a batch needs lies in `batch_*`.
 */
#include "kernel.h"

#define GROUPS 6
#define MOST_CHANNELS 59

enum { MEANS, LOG_SCALES, QUATERNIONS, OPACITY_LOGITS, SH_DC, SH_REST };

static const double MAX_LOG_SCALE = 40;
static const double MAX_OPACITY_LOGIT = 80;

static uint32_t batch_places[BATCH];
/** Lower halves, then upper ones. */
static uint32_t batch_ids[2][BATCH];
static int32_t batch_columns[MOST_CHANNELS * BATCH];
static uint8_t batch_planes[4][BATCH];
/** Steps of means (3), origin (3), and the steps of the other groups. */
static double lattice[11];

static uint64_t keys[1 + MOST_CHANNELS];
static uint32_t channels[GROUPS];
static uint32_t offsets[GROUPS];
static uint32_t width;
static uint32_t colours;

static uint64_t *forms;
static int32_t *integers;
static float *floats[SH_REST];

static uint64_t mix(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

/** Room for so many Gaussians of so many channels of higher harmonics; 0 where there is not that much memory. */
EXPORT(reserve) int32_t reserve(uint32_t capacity, uint32_t rest) {
    const uint32_t counts[GROUPS] = {3, 3, 4, 1, 3, rest};
    for (uint32_t group = 0; group < GROUPS; group++) {
        offsets[group] = width;
        channels[group] = counts[group];
        width += counts[group];
    }
    colours = channels[SH_DC] + rest;
    for (uint32_t key = 0; key <= MOST_CHANNELS; key++) keys[key] = mix((key + 1) * 0x9e3779b97f4a7c15u) | 1;
    const uint64_t rows = capacity;
    forms = (uint64_t *)room_for(8 * rows);
    integers = (int32_t *)room_for(4 * width * rows);
    int32_t found = forms != 0 && integers != 0;
    for (uint32_t group = 0; group <= SH_DC; group++) {
        floats[group] = (float *)room_for(4 * rows * (group == SH_DC ? colours : channels[group]));
        found = found && floats[group] != 0;
    }
    return found;
}

EXPORT(places_at) uint32_t *places_at(void) { return batch_places; }
EXPORT(ids_at) uint32_t *ids_at(void) { return batch_ids[0]; }
EXPORT(columns_at) int32_t *columns_at(void) { return batch_columns; }
EXPORT(planes_at) uint8_t *planes_at(void) { return batch_planes[0]; }
EXPORT(lattice_at) double *lattice_at(void) { return lattice; }
EXPORT(forms_at) uint64_t *forms_at(void) { return forms; }
EXPORT(integers_at) int32_t *integers_at(void) { return integers; }
/** Those of both kinds of harmonics lie behind `SH_DC`. */
EXPORT(floats_at) float *floats_at(uint32_t group) { return floats[group]; }

/** The sum of the hashes of the batch's rows. */
EXPORT(hashes) uint64_t hashes(uint32_t rows) {
    uint64_t sum = 0;
    for (uint32_t i = 0; i < rows; i++) sum += mix(forms[batch_places[i]]);
    return sum;
}

/** A zigzag code's integer. */
static uint32_t integer_of(uint32_t code) { return code >> 1 ^ -(code & 1); }

/** Makes a column of the batch's planes, plus a constant, plus, where `before`, the column before it (SPEC section 6). */
EXPORT(unzigzag) void unzigzag(uint32_t column, uint32_t planes, uint32_t rows, uint32_t constant, uint32_t before) {
    uint32_t *to = (uint32_t *)batch_columns + BATCH * column;
    const uint8_t *p0 = batch_planes[0], *p1 = batch_planes[1], *p2 = batch_planes[2], *p3 = batch_planes[3];
    // A loop for each number of planes: then the compiler makes four integers at once.
    if (planes == 0) {
        for (uint32_t i = 0; i < rows; i++) to[i] = constant;
    } else if (planes == 1) {
        for (uint32_t i = 0; i < rows; i++) to[i] = integer_of(p0[i]) + constant;
    } else if (planes == 2) {
        for (uint32_t i = 0; i < rows; i++) to[i] = integer_of(p0[i] | (uint32_t)p1[i] << 8) + constant;
    } else {
        for (uint32_t i = 0; i < rows; i++) {
            const uint32_t top = planes == 4 ? (uint32_t)p3[i] << 24 : 0;
            to[i] = integer_of(p0[i] | (uint32_t)p1[i] << 8 | (uint32_t)p2[i] << 16 | top) + constant;
        }
    }
    if (before) {
        for (uint32_t i = 0; i < rows; i++) to[i] += to[(int32_t)i - BATCH];
    }
}

/** Adds a group's columns, or their negatives, to the integers of the batch's rows, modulo 2^32, and their products to the forms. */
static void change_group(uint32_t group, uint32_t rows, uint32_t sign) {
    const uint32_t count = channels[group], offset = offsets[group];
    const int32_t *columns = batch_columns + BATCH * offset;
    const uint64_t *key = keys + 1 + offset;
    for (uint32_t i = 0; i < rows; i++) {
        const uint32_t place = batch_places[i];
        int32_t *to = integers + width * place + offset;
        uint64_t form = forms[place];
        for (uint32_t c = 0; c < count; c++) {
            const int32_t before = to[c];
            const int32_t after = (int32_t)((uint32_t)before + sign * (uint32_t)columns[BATCH * c + i]);
            to[c] = after;
            form += key[c] * (uint64_t)((int64_t)after - before);
        }
        forms[place] = form;
    }
}

/** Adds the columns of the groups in `present`, a bit each, times 1 or -1; by how much the sum of hashes grows, modulo 2^64. */
EXPORT(change) uint64_t change(uint32_t rows, uint32_t present, uint32_t sign) {
    const uint64_t before = hashes(rows);
    for (uint32_t group = 0; group < GROUPS; group++) {
        if (present >> group & 1) change_group(group, rows, sign);
    }
    return hashes(rows) - before;
}

/** Writes the batch's Gaussians, zeros for groups that are not in `present`; the sum of their hashes. */
EXPORT(write) uint64_t write(uint32_t rows, uint32_t present) {
    uint64_t sum = 0;
    for (uint32_t i = 0; i < rows; i++) {
        const uint32_t place = batch_places[i];
        int32_t *to = integers + width * place;
        uint64_t form = keys[0] * ((uint64_t)batch_ids[1][i] << 32 | batch_ids[0][i]);
        for (uint32_t group = 0; group < GROUPS; group++) {
            const uint32_t told = present >> group & 1;
            for (uint32_t c = offsets[group]; c < offsets[group] + channels[group]; c++) {
                const int32_t value = told ? batch_columns[BATCH * c + i] : 0;
                to[c] = value;
                form += keys[1 + c] * (uint64_t)(int64_t)value;
            }
        }
        forms[place] = form;
        sum += mix(form);
    }
    return sum;
}

/** Copies the form and the integers of one place to another. */
EXPORT(move) void move(uint32_t from, uint32_t to) {
    forms[to] = forms[from];
    for (uint32_t c = 0; c < width; c++) integers[width * to + c] = integers[width * from + c];
}

static float limited(int32_t value, double step, double most) {
    const double number = value * step;
    return (float)(number > most ? most : number < -most ? -most : number);
}

static void place_means(const int32_t *from, float *to) {
    for (int axis = 0; axis < 3; axis++) to[axis] = (float)(from[axis] * lattice[axis] + lattice[3 + axis]);
}

static void turn(const int32_t *from, float *to) {
    for (int part = 0; part < 4; part++) to[part] = (float)(from[part] * lattice[7]);
    if ((from[0] | from[1] | from[2] | from[3]) == 0) to[0] = 1;
}

/** Puts the batch's rows on the lattice, groups in `present` only: products and sums in float64, rounded once. */
EXPORT(dequantise) void dequantise(uint32_t rows, uint32_t present) {
    for (uint32_t i = 0; i < rows; i++) {
        const uint32_t place = batch_places[i];
        const int32_t *from = integers + width * place;
        float *sh = floats[SH_DC] + colours * place;
        if (present & 1 << MEANS) place_means(from, floats[MEANS] + 3 * place);
        if (present & 1 << LOG_SCALES) {
            for (int axis = 0; axis < 3; axis++) {
                floats[LOG_SCALES][3 * place + axis] = limited(from[3 + axis], lattice[6], MAX_LOG_SCALE);
            }
        }
        if (present & 1 << QUATERNIONS) turn(from + 6, floats[QUATERNIONS] + 4 * place);
        if (present & 1 << OPACITY_LOGITS) {
            floats[OPACITY_LOGITS][place] = limited(from[10], lattice[8], MAX_OPACITY_LOGIT);
        }
        if (present & 1 << SH_DC) {
            for (uint32_t c = 0; c < 3; c++) sh[c] = (float)(from[11 + c] * lattice[9]);
        }
        if (present & 1 << SH_REST) {
            for (uint32_t c = 3; c < colours; c++) sh[c] = (float)(from[11 + c] * lattice[10]);
        }
    }
}
