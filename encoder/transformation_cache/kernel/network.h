// The cache's multi-layer perceptron: hidden layers with ReLU, a linear last layer. Its parameters are one array: layer by
// layer the matrix (out, given), then the bias (out,), with out and given rounded up to sixteen and zero there. Zero
// parameters with zero gradients stay zero under Adam, so the padding never shows.
#pragma once

#include <cstdint>
#include <vector>

#include "product.h"

namespace decogs {

// A function of its own: amid other code a compiler runs out of registers in the loops that take the time.
#define DECOGS_APART inline __attribute__((noinline))

constexpr int kOutputs = 7;  // translation 3, rotation 4
constexpr int kBlock = 64;   // rows that go through all layers together: few enough to stay in cache with the weights
constexpr int kChunk = 512;  // rows whose gradients are summed together; part of the results' definition

inline int padded(int count) { return (count + kLanes - 1) / kLanes * kLanes; }

struct Layer {
    int given, out;
    int64_t matrix, bias;  // where they begin
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

    // The matrices transposed, (given, out), each in the place of its original.
    void transpose(const float* head, float* to) const {
        for (const Layer& layer : layers)
            for (int j = 0; j < layer.out_padded(); ++j)
                for (int k = 0; k < layer.given_padded(); ++k)
                    to[layer.matrix + static_cast<int64_t>(k) * layer.out_padded() + j] =
                        head[layer.matrix + static_cast<int64_t>(j) * layer.given_padded() + k];
    }
};

// One layer on `rows` rows, a multiple of four: to (rows, out) from x (rows, given).
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

// Adds to `gradient`, laid out like the parameters, that of one layer for inputs x (rows, given) and cotangents v (rows, out).
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

// Cotangents of a layer's inputs, to (rows, given), from those of its outputs, v (rows, out). Inputs that a ReLU gave, not
// null, pass the cotangent on where they are positive.
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
