#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "arrays.hpp"

// Gaussian processes with a linear and a smooth covariance of features, one for each of m errors that share their rows. The
// Cholesky factor of an error's covariance is stored as its lower triangle, row after row, n (n + 1) / 2 numbers. A row of it
// depends only on the rows before it, and every sum has a fixed order: a factor that grew row by row is, bit for bit, the
// one that `process_rebuild` makes. So a state needs no factors.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define TALC_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define TALC_WIDE
#endif

#define TALC_ALONE __restrict__  // nothing else points there: GCC and Clang have this keyword, C++ does not

namespace talc {

TALC_WIDE inline double ordered_dot(const double *TALC_ALONE a, const double *TALC_ALONE b, size_t n) {
    double sums[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    size_t i = 0;
    for (; i + 8 <= n; i += 8)
        for (size_t q = 0; q < 8; ++q) sums[q] += a[i + q] * b[i + q];
    double rest = 0.0;
    for (; i < n; ++i) rest += a[i] * b[i];
    return (((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))) + rest;
}

TALC_WIDE inline void ordered_add(double *TALC_ALONE to, const double *TALC_ALONE from, double factor, size_t n) {
    for (size_t i = 0; i < n; ++i) to[i] += factor * from[i];
}

// What the features alone contribute to the covariance of x with a row: c'row, c being x times the prior variances of the
// weights, and the smooth part, which is zero at the reference x = 0.
inline double between(const double *row, double row_square, const double *c, const double *x, double x_square, double smooth,
                      double inverse, size_t p) {
    double found = ordered_dot(c, row, p);
    if (smooth > 0.0) {
        const double apart = std::max(x_square + row_square - 2.0 * ordered_dot(x, row, p), 0.0);
        found += smooth * (std::exp(-inverse * apart) - std::exp(-inverse * x_square) * std::exp(-inverse * row_square));
    }
    return found;
}

// v := L^-1 v in place.
inline void forward(const double *lower, double *v, size_t n) {
    for (size_t i = 0; i < n; ++i) {
        const double *row = lower + i * (i + 1) / 2;
        v[i] = (v[i] - ordered_dot(row, v, i)) / row[i];
    }
}

// Row n of a factor and of the whitened measurements. Not measured (own = inf): a row that changes nothing.
inline void append(double *lower, double *z, const double *v, double mean, double spread, double own, double y, size_t n) {
    double *row = lower + n * (n + 1) / 2;
    if (std::isinf(own)) {
        std::fill_n(row, n, 0.0);
        row[n] = 1.0;
        z[n] = 0.0;
        return;
    }
    std::copy_n(v, n, row);
    row[n] = std::sqrt(std::max(own - spread, 1e-9 * own));
    z[n] = (y - mean) / row[n];
}

// Of each error: v := L^-1 k with k the covariance of x with its n rows, mean := v'z, spread := v'v.
// level: what level and reference add to each row's covariance; known: 1 where a row measured the error, else 0.
inline void process_look(Matrix rows, Vector squares, size_t n, Matrix c, Vector x, double square, double smooth, double inverse, Matrix level,
                         Matrix known, Matrix lower, Matrix z, MatrixOut v, VectorOut mean, VectorOut spread) {
    const size_t errors = lower.shape(0), p = rows.shape(1), most = rows.shape(0), own = c.shape(0);
    if (n > most || lower.shape(1) != most * (most + 1) / 2 || z.shape(0) != errors || z.shape(1) != most ||
        v.shape(0) != errors || v.shape(1) != most || level.shape(0) != errors || level.shape(1) != most ||
        known.shape(0) != errors || known.shape(1) != most || c.shape(1) != p || (own != 1 && own != errors) ||
        x.shape(0) != p || squares.shape(0) != most || mean.shape(0) != errors || spread.shape(0) != errors)
        throw nb::value_error("processes: shapes do not fit together");
    nb::gil_scoped_release release;
    std::vector<double> shared(own == 1 ? n : 0);
    for (size_t i = 0; i < shared.size(); ++i)
        shared[i] = between(rows.data() + i * p, squares.data()[i], c.data(), x.data(), square, smooth, inverse, p);
    for (size_t j = 0; j < errors; ++j) {
        double *to = v.data() + j * most;
        for (size_t i = 0; i < n; ++i) {
            const double k = own == 1 ? shared[i]
                                      : between(rows.data() + i * p, squares.data()[i], c.data() + j * p, x.data(), square,
                                                smooth, inverse, p);
            to[i] = (k + level.data()[j * most + i]) * known.data()[j * most + i];
        }
        forward(lower.data() + j * lower.shape(1), to, n);
        mean.data()[j] = ordered_dot(to, z.data() + j * most, n);
        spread.data()[j] = ordered_dot(to, to, n);
    }
}

// After process_look at the row that becomes row n: its own variances, inf where not measured, and its measurements.
inline void process_append(MatrixOut lower, MatrixOut z, size_t n, Matrix v, Vector mean, Vector spread, Vector own,
                           Vector y) {
    const size_t errors = lower.shape(0), most = z.shape(1);
    if (n >= most || lower.shape(1) != most * (most + 1) / 2 || z.shape(0) != errors || v.shape(0) != errors ||
        v.shape(1) != most || mean.shape(0) != errors || spread.shape(0) != errors || own.shape(0) != errors ||
        y.shape(0) != errors)
        throw nb::value_error("processes: shapes do not fit together");
    for (size_t j = 0; j < errors; ++j)
        append(lower.data() + j * lower.shape(1), z.data() + j * most, v.data() + j * most, mean.data()[j], spread.data()[j],
               own.data()[j], y.data()[j], n);
}

// One error's factor and whitened measurements from its rows. c: (rows, p) each row times the prior variances; level: what
// an older row adds to the covariance with a later one; own: variances of the rows, inf where not measured.
inline void process_rebuild(Matrix rows, Vector squares, size_t n, Matrix c, double smooth, double inverse, Vector level,
                            Vector known, Vector own, Vector y, VectorOut lower, VectorOut z) {
    const size_t p = rows.shape(1), most = rows.shape(0);
    if (n > most || c.shape(0) < n || c.shape(1) != p || squares.shape(0) != most || level.shape(0) != most ||
        known.shape(0) != most || own.shape(0) != most || y.shape(0) != most || z.shape(0) != most ||
        lower.shape(0) != most * (most + 1) / 2)
        throw nb::value_error("processes: shapes do not fit together");
    nb::gil_scoped_release release;
    std::vector<double> v(n);
    for (size_t i = 0; i < n; ++i) {
        const double *x = rows.data() + i * p;
        for (size_t l = 0; l < i; ++l)
            v[l] = (between(rows.data() + l * p, squares.data()[l], c.data() + i * p, x, squares.data()[i], smooth, inverse,
                            p) +
                    level.data()[l]) *
                   known.data()[l];
        forward(lower.data(), v.data(), i);
        append(lower.data(), z.data(), v.data(), ordered_dot(v.data(), z.data(), i), ordered_dot(v.data(), v.data(), i),
               own.data()[i], y.data()[i], i);
    }
}

// One error's K^-1 y = L'^-1 z; 0 for rows that did not measure it.
inline void process_shares(Vector lower, Vector z, size_t n, VectorOut shares) {
    if (z.shape(0) < n || shares.shape(0) < n || lower.shape(0) < n * (n + 1) / 2)
        throw nb::value_error("processes: shapes do not fit together");
    std::copy_n(z.data(), n, shares.data());
    for (size_t i = n; i-- > 0;) {
        const double *row = lower.data() + i * (i + 1) / 2;
        shares.data()[i] /= row[i];
        ordered_add(shares.data(), row, -shares.data()[i], i);
    }
}

// whitened := L^-1 rows, of the rows that measured the error; the others are 0.
inline void process_whiten(Matrix rows, size_t n, Vector known, Vector lower, MatrixOut whitened) {
    const size_t p = rows.shape(1);
    if (rows.shape(0) < n || known.shape(0) < n || lower.shape(0) < n * (n + 1) / 2 || whitened.shape(0) < n ||
        whitened.shape(1) != p)
        throw nb::value_error("processes: shapes do not fit together");
    nb::gil_scoped_release release;
    for (size_t i = 0; i < n; ++i) {
        const double *row = lower.data() + i * (i + 1) / 2;
        double *to = whitened.data() + i * p;
        for (size_t d = 0; d < p; ++d) to[d] = known.data()[i] * rows.data()[i * p + d];
        for (size_t l = 0; l < i; ++l) ordered_add(to, whitened.data() + l * p, -row[l], p);
        for (size_t d = 0; d < p; ++d) to[d] /= row[i];
    }
}

inline void bind_process(nb::module_ &m) {
    m.def("process_look", &process_look, nb::arg("rows"), nb::arg("squares"), nb::arg("n"), nb::arg("c"), nb::arg("x"),
          nb::arg("square"), nb::arg("smooth"), nb::arg("inverse"), nb::arg("level"), nb::arg("known"), nb::arg("lower"),
          nb::arg("z"), nb::arg("v"), nb::arg("mean"), nb::arg("spread"),
          "Of each error: v := L^-1 k with the covariances k of x with its n rows, mean := v'z, spread := v'v.");
    m.def("process_append", &process_append, nb::arg("lower"), nb::arg("z"), nb::arg("n"), nb::arg("v"), nb::arg("mean"),
          nb::arg("spread"), nb::arg("own"), nb::arg("y"), "Row n of each factor, after process_look at it.");
    m.def("process_rebuild", &process_rebuild, nb::arg("rows"), nb::arg("squares"), nb::arg("n"), nb::arg("c"),
          nb::arg("smooth"), nb::arg("inverse"), nb::arg("level"), nb::arg("known"), nb::arg("own"), nb::arg("y"),
          nb::arg("lower"), nb::arg("z"), "One error's factor and whitened measurements, from its rows.");
    m.def("process_shares", &process_shares, nb::arg("lower"), nb::arg("z"), nb::arg("n"), nb::arg("shares"),
          "One error's K^-1 y.");
    m.def("process_whiten", &process_whiten, nb::arg("rows"), nb::arg("n"), nb::arg("known"), nb::arg("lower"),
          nb::arg("whitened"), "One error's L^-1 rows.");
}
}  // namespace talc
