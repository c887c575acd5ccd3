// The cache's MLP: hidden layers with ReLU, a linear output layer. Parameters are one array: per layer the matrix (out, given),
// then the bias (out,), zero-padded to multiples of sixteen. The padding has zero gradients, so Adam keeps it zero.
#pragma once

#include <cstdint>
#include <vector>

#include "product.h"

namespace decogs {

// Not inlined: compilers run out of registers when the hot loops are part of a larger function.
#define DECOGS_APART inline __attribute__((noinline))

constexpr int kOutputs = 7;  // translation 3, rotation 4
constexpr int kBlock = 64;   // rows that pass all layers together: they fit into cache with the weights
constexpr int kChunk = 512;  // rows per gradient sum; fixes the order of sums, and so the bits

inline int padded(int count) { return (count + kLanes - 1) / kLanes * kLanes; }

struct Layer {
    int given, out;
    int64_t matrix, bias;  // offsets in the parameters
    int given_padded() const { return padded(given); }
    int out_padded() const { return padded(out); }
};

struct Network {
    std::vector<Layer> layers;
    int64_t size = 0;

    Network(int inputs, int hidden_layers, int hidden_width) {
        for (int k = 0, given = inputs; k <= hidden_layers; ++k) {
            const int out = k < hidden_layers ? hidden_width : kOutputs;
            Layer layer{given, out, size, 0};
            layer.bias = size + static_cast<int64_t>(layer.out_padded()) * layer.given_padded();
            size = layer.bias + layer.out_padded();
            layers.push_back(layer);
            given = out;
        }
    }

    // Transposes the matrices to (given, out), at the same offsets.
    void transpose(const float* head, float* to) const {
        for (const Layer& layer : layers)
            for (int j = 0; j < layer.out_padded(); ++j)
                for (int k = 0; k < layer.given_padded(); ++k)
                    to[layer.matrix + static_cast<int64_t>(k) * layer.out_padded() + j] =
                        head[layer.matrix + static_cast<int64_t>(j) * layer.given_padded() + k];
    }
};

// Forward pass of one layer on `rows` rows, a multiple of four: x (rows, given) to `to` (rows, out).
DECOGS_APART void layer_forward(const Layer& layer, bool last, const float* head, const float* transposed, int rows,
                                const float* x, float* to) {
    const int64_t given = layer.given_padded(), out = layer.out_padded();
    const float* bias = head + layer.bias;
    const auto start = [&](int, int j) { return load_native(bias + j); };
    const Left left{x, given, 1};
    const Right right{transposed + layer.matrix, out};
    if (last)
        product(rows, layer.out, layer.given, left, right, start,
                [&](int i, int j, const NativeF& sum) { store_native(to + i * out + j, sum); });
    else
        product(rows, layer.out, layer.given, left, right, start, [&](int i, int j, const NativeF& sum) {
            store_native(to + i * out + j, sum > 0.0f ? sum : NativeF{});
        });
}

// Accumulates a layer's parameter gradient from inputs x (rows, given) and cotangents v (rows, out).
DECOGS_APART void layer_gradient(const Layer& layer, int rows, const float* x, const float* v, float* gradient) {
    const int64_t given = layer.given_padded(), out = layer.out_padded();
    float *matrix = gradient + layer.matrix, *bias = gradient + layer.bias;
    product((layer.out + kTileRows - 1) / kTileRows * kTileRows, layer.given, rows, Left{v, 1, out}, Right{x, given},
            [&](int j, int k) { return load_native(matrix + j * given + k); },
            [&](int j, int k, const NativeF& sum) { store_native(matrix + j * given + k, sum); });
    for (int j = 0; j < out; j += kLanes) {
        F sum = load(bias + j);
        for (int i = 0; i < rows; ++i) sum = sum + load(v + i * out + j);
        store(bias + j, sum);
    }
}

// Backward pass of one layer: cotangents `to` (rows, given) of its inputs from v (rows, out) of its outputs. `relu`, if not
// null: the inputs, a ReLU's outputs; cotangents pass where these are positive.
DECOGS_APART void layer_backward(const Layer& layer, const float* head, int rows, const float* v, const float* relu,
                                 float* to) {
    const int64_t given = layer.given_padded(), out = layer.out_padded();
    const auto start = [](int, int) { return NativeF{}; };
    const Left left{v, out, 1};
    const Right right{head + layer.matrix, given};
    if (relu)
        product(rows, layer.given, layer.out, left, right, start, [&](int i, int k, const NativeF& sum) {
            store_native(to + i * given + k, load_native(relu + i * given + k) > 0.0f ? sum : NativeF{});
        });
    else
        product(rows, layer.given, layer.out, left, right, start,
                [&](int i, int k, const NativeF& sum) { store_native(to + i * given + k, sum); });
}

}  // namespace decogs
