#pragma once
#include <cmath>
#include <cstddef>

namespace talc {

// Cholesky factor of a symmetric positive definite n x n matrix, row-major, in its lower triangle. False: not definite.
inline bool cholesky(double *m, size_t n) {
    for (size_t j = 0; j < n; ++j) {
        double *row = m + j * n;
        double d = row[j];
        for (size_t k = 0; k < j; ++k) d -= row[k] * row[k];
        if (!(d > 0.0)) return false;
        const double root = std::sqrt(d), inverse = 1.0 / root;
        row[j] = root;
        for (size_t i = j + 1; i < n; ++i) {
            double *below = m + i * n;
            double s = below[j];
            for (size_t k = 0; k < j; ++k) s -= below[k] * row[k];
            below[j] = s * inverse;
        }
    }
    return true;
}

// x := (L L')^-1 x for a factor made by cholesky.
inline void cholesky_solve(const double *factor, size_t n, double *x) {
    for (size_t i = 0; i < n; ++i) {
        double s = x[i];
        for (size_t k = 0; k < i; ++k) s -= factor[i * n + k] * x[k];
        x[i] = s / factor[i * n + i];
    }
    for (size_t i = n; i-- > 0;) {
        double s = x[i];
        for (size_t k = i + 1; k < n; ++k) s -= factor[k * n + i] * x[k];
        x[i] = s / factor[i * n + i];
    }
}
}  // namespace talc
