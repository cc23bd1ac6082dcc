//! SIMD dispatch, matrix product, convolution, pooling and activations.
