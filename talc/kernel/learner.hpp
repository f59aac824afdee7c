#pragma once
#include <cmath>
#include <cstddef>
#include <vector>

#include "arrays.hpp"

// Kalman filters of linear weights, many at once. A covariance is stored once: its lower triangle, row after row, n (n + 1)
// / 2 numbers. So it is symmetric by construction. Sums have a fixed order: results are the same on every processor.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define TALC_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define TALC_WIDE
#endif

namespace talc {

// h := P x.
TALC_WIDE inline void packed_times(const double *p, const double *x, double *h, size_t n) {
    for (size_t i = 0; i < n; ++i) h[i] = 0.0;
    for (size_t i = 0; i < n; ++i) {
        double sums[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        const double own = x[i];
        size_t j = 0;
        for (; j + 8 <= i; j += 8)
            for (size_t q = 0; q < 8; ++q) {
                sums[q] += p[j + q] * x[j + q];
                h[j + q] += p[j + q] * own;
            }
        double rest = 0.0;
        for (; j < i; ++j) {
            rest += p[j] * x[j];
            h[j] += p[j] * own;
        }
        h[i] += (((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))) + rest +
                p[i] * own;
        p += i + 1;
    }
}

// P := P - h h' / s.
TALC_WIDE inline void packed_downdate(double *p, const double *h, double s, size_t n) {
    for (size_t i = 0; i < n; ++i) {
        const double factor = h[i] / s;
        for (size_t j = 0; j <= i; ++j) p[j] -= factor * h[j];
        p += i + 1;
    }
}

// P := P - sum_q g_q c_q', q = 0..width-1; g and c hold one row per q.
TALC_WIDE inline void packed_subtract(double *p, const double *g, const double *c, size_t width, size_t n) {
    for (size_t i = 0; i < n; ++i) {
        for (size_t q = 0; q < width; ++q) {
            const double factor = g[q * n + i];
            const double *row = c + q * n;
            for (size_t j = 0; j <= i; ++j) p[j] -= factor * row[j];
        }
        p += i + 1;
    }
}

TALC_WIDE inline void add_scaled(double *to, const double *from, double factor, size_t n) {
    for (size_t i = 0; i < n; ++i) to[i] += factor * from[i];
}

TALC_WIDE inline double packed_dot(const double *a, const double *b, size_t n) {
    double sums[4] = {0.0, 0.0, 0.0, 0.0};
    size_t i = 0;
    for (; i + 4 <= n; i += 4)
        for (size_t q = 0; q < 4; ++q) sums[q] += a[i + q] * b[i + q];
    double rest = 0.0;
    for (; i < n; ++i) rest += a[i] * b[i];
    return ((sums[0] + sums[1]) + (sums[2] + sums[3])) + rest;
}

// Of each filter: diagonal += growth; gain := P x; spread := x' P x.
inline void filters_look(MatrixOut covariance, Matrix growth, Vector x, MatrixOut gain, VectorOut spread) {
    const size_t n = x.shape(0), filters = covariance.shape(0), packed = n * (n + 1) / 2;
    if (covariance.shape(1) != packed || growth.shape(0) != filters || growth.shape(1) != n || gain.shape(0) != filters ||
        gain.shape(1) != n || spread.shape(0) != filters)
        throw nb::value_error("filters: shapes do not fit together");
    nb::gil_scoped_release release;
    for (size_t e = 0; e < filters; ++e) {
        double *p = covariance.data() + e * packed, *h = gain.data() + e * n;
        const double *add = growth.data() + e * n;
        for (size_t i = 0, d = 0; i < n; d += ++i + 1) p[d] += add[i];
        packed_times(p, x.data(), h, n);
        spread.data()[e] = packed_dot(h, x.data(), n);
    }
}

// Of each filter: condition on an innovation seen with noise, after filters_look. spread: x' P x.
inline void filters_learn(MatrixOut covariance, MatrixOut mean, Matrix gain, Vector spread, Vector innovation, double noise) {
    const size_t filters = covariance.shape(0), n = mean.shape(1), packed = n * (n + 1) / 2;
    if (covariance.shape(1) != packed || mean.shape(0) != filters || gain.shape(0) != filters || gain.shape(1) != n ||
        spread.shape(0) != filters || innovation.shape(0) != filters || !(noise > 0.0))
        throw nb::value_error("filters: shapes do not fit together, or no noise");
    nb::gil_scoped_release release;
    for (size_t e = 0; e < filters; ++e) {
        const double *h = gain.data() + e * n;
        const double total = spread.data()[e] + noise;
        add_scaled(mean.data() + e * n, h, innovation.data()[e] / total, n);
        packed_downdate(covariance.data() + e * packed, h, total, n);
    }
}

// One filter: the weights first..first+width-1 have `information` more about being zero (less, when negative).
inline void filter_inform(VectorOut covariance, VectorOut mean, size_t first, size_t width, double information) {
    const size_t n = mean.shape(0);
    if (covariance.shape(0) != n * (n + 1) / 2 || first + width > n || width == 0 || information == 0.0)
        throw nb::value_error("filter: shapes do not fit together, or nothing to say");
    nb::gil_scoped_release release;
    double *p = covariance.data();
    std::vector<double> column(width * n), gain(width * n), small(width * width), value(width);
    for (size_t q = 0; q < width; ++q) {
        const size_t i = first + q;
        for (size_t j = 0; j <= i; ++j) column[q * n + j] = p[i * (i + 1) / 2 + j];
        for (size_t j = i + 1; j < n; ++j) column[q * n + j] = p[j * (j + 1) / 2 + i];
        value[q] = mean.data()[i];
    }
    for (size_t q = 0; q < width; ++q)
        for (size_t s = 0; s < width; ++s)
            small[q * width + s] = column[q * n + first + s] + (q == s ? 1.0 / information : 0.0);
    // (1 / information + P_gg) is definite of either sign: elimination needs no pivots. gain := its inverse times column.
    gain = column;
    for (size_t q = 0; q < width; ++q) {
        const double pivot = small[q * width + q];
        for (size_t s = q + 1; s < width; ++s) {
            const double factor = small[s * width + q] / pivot;
            for (size_t t = q; t < width; ++t) small[s * width + t] -= factor * small[q * width + t];
            add_scaled(gain.data() + s * n, gain.data() + q * n, -factor, n);
        }
    }
    for (size_t q = width; q-- > 0;) {
        for (size_t s = q + 1; s < width; ++s)
            add_scaled(gain.data() + q * n, gain.data() + s * n, -small[q * width + s], n);
        for (size_t j = 0; j < n; ++j) gain[q * n + j] /= small[q * width + q];
    }
    for (size_t q = 0; q < width; ++q) add_scaled(mean.data(), gain.data() + q * n, -value[q], n);
    packed_subtract(p, gain.data(), column.data(), width, n);
}

// One filter in other units: weight i becomes factor_i times itself.
inline void filter_rescale(VectorOut covariance, VectorOut mean, Vector factor) {
    const size_t n = mean.shape(0);
    if (covariance.shape(0) != n * (n + 1) / 2 || factor.shape(0) != n)
        throw nb::value_error("filter: shapes do not fit together");
    double *p = covariance.data();
    for (size_t i = 0; i < n; ++i) {
        mean.data()[i] *= factor.data()[i];
        for (size_t j = 0; j <= i; ++j) *p++ *= factor.data()[i] * factor.data()[j];
    }
}

// mixed := sum of weight_e P_e over the filters with at least `least` weight.
inline void filters_mix(Matrix covariance, Vector weight, double least, VectorOut mixed) {
    const size_t filters = covariance.shape(0), packed = covariance.shape(1);
    if (weight.shape(0) != filters || mixed.shape(0) != packed) throw nb::value_error("filters: shapes do not fit together");
    nb::gil_scoped_release release;
    for (size_t i = 0; i < packed; ++i) mixed.data()[i] = 0.0;
    for (size_t e = 0; e < filters; ++e)
        if (weight.data()[e] >= least) add_scaled(mixed.data(), covariance.data() + e * packed, weight.data()[e], packed);
}

// What each mixture says: the mean of its filters' means, and its variance: x' mixed x, what the weights have drifted
// since (elapsed x' drift x), and how far the filters are apart.
inline void mixtures_predict(Stack3 mean, Matrix weight, Matrix mixed, Matrix drift, Vector elapsed, Vector x,
                             VectorOut predicted, VectorOut variance) {
    const size_t errors = mean.shape(0), filters = mean.shape(1), n = mean.shape(2), packed = n * (n + 1) / 2;
    if (weight.shape(0) != errors || weight.shape(1) != filters || mixed.shape(0) != errors || mixed.shape(1) != packed ||
        drift.shape(0) != errors || drift.shape(1) != n || elapsed.shape(0) != errors || x.shape(0) != n ||
        predicted.shape(0) != errors || variance.shape(0) != errors)
        throw nb::value_error("mixtures: shapes do not fit together");
    nb::gil_scoped_release release;
    std::vector<double> own(filters), h(n);
    for (size_t j = 0; j < errors; ++j) {
        const double *w = weight.data() + j * filters;
        double centre = 0.0, apart = 0.0, drifted = 0.0;
        for (size_t e = 0; e < filters; ++e) {
            own[e] = packed_dot(mean.data() + (j * filters + e) * n, x.data(), n);
            centre += w[e] * own[e];
        }
        for (size_t e = 0; e < filters; ++e) apart += w[e] * (own[e] - centre) * (own[e] - centre);
        const double *q = drift.data() + j * n;
        for (size_t i = 0; i < n; ++i) drifted += q[i] * x.data()[i] * x.data()[i];
        packed_times(mixed.data() + j * packed, x.data(), h.data(), n);
        predicted.data()[j] = centre;
        variance.data()[j] = packed_dot(h.data(), x.data(), n) + elapsed.data()[j] * drifted + apart;
    }
}

inline void bind_learner(nb::module_ &m) {
    m.def("filters_look", &filters_look, nb::arg("covariance"), nb::arg("growth"), nb::arg("x"), nb::arg("gain"),
          nb::arg("spread"), "Grow the covariances (filters, n (n + 1) / 2); gain := P x, spread := x' P x.");
    m.def("filters_learn", &filters_learn, nb::arg("covariance"), nb::arg("mean"), nb::arg("gain"), nb::arg("spread"),
          nb::arg("innovation"), nb::arg("noise"), "Condition each filter on its innovation, after filters_look.");
    m.def("filter_inform", &filter_inform, nb::arg("covariance"), nb::arg("mean"), nb::arg("first"), nb::arg("width"),
          nb::arg("information"), "Add information that some weights of one filter are zero; negative: take it away.");
    m.def("filter_rescale", &filter_rescale, nb::arg("covariance"), nb::arg("mean"), nb::arg("factor"),
          "One filter's weights, times factors.");
    m.def("filters_mix", &filters_mix, nb::arg("covariance"), nb::arg("weight"), nb::arg("least"), nb::arg("mixed"),
          "Weighted sum of the covariances.");
    m.def("mixtures_predict", &mixtures_predict, nb::arg("mean"), nb::arg("weight"), nb::arg("mixed"), nb::arg("drift"),
          nb::arg("elapsed"), nb::arg("x"), nb::arg("predicted"), nb::arg("variance"),
          "Mean and variance of each error's mixture of filters.");
}
}  // namespace talc
