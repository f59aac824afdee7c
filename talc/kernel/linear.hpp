#pragma once
#include <cmath>
#include <cstddef>

namespace talc {

// Cholesky factor U'U of a symmetric positive definite n x n matrix, row-major, in its upper triangle; the lower one is
// not read. Rows are updated whole, which compilers vectorise without reordering any sum. False: not definite.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
// The wider instructions where the processor has them; no sum is reordered, so results are the same without.
__attribute__((target_clones("avx2", "default")))
#endif
inline bool cholesky(double *m, size_t n) {
    constexpr size_t panel = 4;
    for (size_t j = 0; j < n; j += panel) {
        const size_t end = j + panel < n ? j + panel : n;
        for (size_t r = j; r < end; ++r) {
            double *row = m + r * n;
            if (!(row[r] > 0.0)) return false;
            const double root = std::sqrt(row[r]), inverse = 1.0 / root;
            row[r] = root;
            for (size_t k = r + 1; k < n; ++k) row[k] *= inverse;
            for (size_t i = r + 1; i < end; ++i) {
                const double factor = row[i];
                double *below = m + i * n;
                for (size_t k = i; k < n; ++k) below[k] -= factor * row[k];
            }
        }
        if (end - j < panel) break;
        const double *r0 = m + j * n, *r1 = r0 + n, *r2 = r1 + n, *r3 = r2 + n;
        for (size_t i = end; i < n; ++i) {
            const double f0 = r0[i], f1 = r1[i], f2 = r2[i], f3 = r3[i];
            double *below = m + i * n;
            for (size_t k = i; k < n; ++k) below[k] -= ((f0 * r0[k] + f1 * r1[k]) + (f2 * r2[k] + f3 * r3[k]));
        }
    }
    return true;
}

// x := (U'U)^-1 x for a factor made by cholesky.
inline void cholesky_solve(const double *factor, size_t n, double *x) {
    for (size_t i = 0; i < n; ++i) {
        const double *row = factor + i * n;
        x[i] /= row[i];
        for (size_t k = i + 1; k < n; ++k) x[k] -= row[k] * x[i];
    }
    for (size_t i = n; i-- > 0;) {
        const double *row = factor + i * n;
        double s = x[i];
        for (size_t k = i + 1; k < n; ++k) s -= row[k] * x[k];
        x[i] = s / row[i];
    }
}
}  // namespace talc
