// Tiles of which nothing was recorded, and which nobody needs to see: what lies in them is neither drawn nor differentiated.
#pragma once

#include <cstring>

#include "backward.h"

namespace decogs {

// Drops the entries of tiles that are not `wanted` (one byte per tile; null: all are).
inline void drop_unwanted(const uint8_t* wanted, TileLists& lists) {
    if (!wanted) return;
    uint32_t kept = 0, begin = 0;
    for (int t = 0; t < lists.tiles(); ++t) {
        const uint32_t end = lists.first_entry[t + 1];
        for (uint32_t e = begin; wanted[t] && e < end; ++e) lists.entries[kept++] = lists.entries[e];
        begin = end;
        lists.first_entry[t + 1] = kept;
    }
}

// Zeroes the moments of the pairs whose entries were dropped.
inline void silence_unwanted(const uint8_t* wanted, const TileLists& lists, float* moments) {
    if (!wanted) return;
    for (size_t pair = 0; pair < lists.tile_of_pair.size(); ++pair)
        if (!wanted[lists.tile_of_pair[pair]]) std::memset(moments + pair * kMoments, 0, kMoments * sizeof(float));
}

}  // namespace decogs
