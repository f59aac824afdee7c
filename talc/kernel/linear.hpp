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
    constexpr size_t panel = 8;
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
        const double *r = m + j * n;
        for (size_t i = end; i < n; ++i) {
            double f[panel];
            for (size_t q = 0; q < panel; ++q) f[q] = r[q * n + i];
            double *below = m + i * n;
            for (size_t k = i; k < n; ++k)
                below[k] -= ((f[0] * r[k] + f[1] * r[n + k]) + (f[2] * r[2 * n + k] + f[3] * r[3 * n + k])) +
                            ((f[4] * r[4 * n + k] + f[5] * r[5 * n + k]) + (f[6] * r[6 * n + k] + f[7] * r[7 * n + k]));
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
        // Four sums side by side: one alone waits for each of its additions.
        double s[4] = {0.0, 0.0, 0.0, 0.0};
        size_t k = i + 1;
        for (; k + 4 <= n; k += 4)
            for (size_t q = 0; q < 4; ++q) s[q] += row[k + q] * x[k + q];
        for (; k < n; ++k) s[0] += row[k] * x[k];
        x[i] = (x[i] - ((s[0] + s[1]) + (s[2] + s[3]))) / row[i];
    }
}
}  // namespace talc
