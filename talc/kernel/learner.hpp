#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "arrays.hpp"

// Kalman filters of linear weights, many at once. A covariance is stored once: its lower triangle, row after row, n (n + 1)
// / 2 numbers. So it is symmetric by construction. Sums have a fixed order: the compiler chooses nothing.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define TALC_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define TALC_WIDE
#endif

#define TALC_ALONE __restrict__  // nothing else points there: GCC and Clang have this keyword, C++ does not

namespace talc {

// h := P x. Rows without variance are skipped: a filter that does not estimate a weight has zeros there.
TALC_WIDE inline void packed_times(const double *TALC_ALONE p, const double *TALC_ALONE x, double *TALC_ALONE h, size_t n) {
    for (size_t i = 0; i < n; ++i) h[i] = 0.0;
    for (size_t i = 0; i < n; p += ++i) {
        if (p[i] == 0.0) continue;
        double sums[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        const double own = x[i];
        size_t j = 0;
        for (; j + 8 <= i; j += 8)
            for (size_t q = 0; q < 8; ++q) sums[q] += p[j + q] * x[j + q];
        double rest = 0.0;
        for (; j < i; ++j) rest += p[j] * x[j];
        for (j = 0; j < i; ++j) h[j] += p[j] * own;
        h[i] += (((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))) + rest +
                p[i] * own;
    }
}

// x' P x.
TALC_WIDE inline double packed_square(const double *p, const double *x, size_t n) {
    double total = 0.0;
    for (size_t i = 0; i < n; ++i) {
        double sums[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        size_t j = 0;
        for (; j + 8 <= i; j += 8)
            for (size_t q = 0; q < 8; ++q) sums[q] += p[j + q] * x[j + q];
        double rest = 0.0;
        for (; j < i; ++j) rest += p[j] * x[j];
        const double below =
            (((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))) + rest;
        total += x[i] * (2.0 * below + p[i] * x[i]);
        p += i + 1;
    }
    return total;
}

// P := P - h h' / s.
TALC_WIDE inline void packed_downdate(double *TALC_ALONE p, const double *TALC_ALONE h, double s, size_t n) {
    for (size_t i = 0; i < n; p += ++i) {
        if (h[i] == 0.0) continue;
        const double factor = h[i] / s;
        for (size_t j = 0; j <= i; ++j) p[j] -= factor * h[j];
    }
}

// P := P - sum_q g_q c_q', q = 0..width-1; g and c hold one row per q. Five at once, as a row of P is then read once.
TALC_WIDE inline void packed_subtract(double *TALC_ALONE p, const double *TALC_ALONE g, const double *TALC_ALONE c,
                                      size_t width, size_t n) {
    for (size_t i = 0; i < n; ++i) {
        size_t q = 0;
        for (; q + 5 <= width; q += 5) {
            const double *own = g + q * n + i, *r = c + q * n;
            const double a = own[0], b = own[n], d = own[2 * n], e = own[3 * n], f = own[4 * n];
            for (size_t j = 0; j <= i; ++j)
                p[j] = p[j] - a * r[j] - b * r[n + j] - d * r[2 * n + j] - e * r[3 * n + j] - f * r[4 * n + j];
        }
        for (; q < width; ++q) {
            const double factor = g[q * n + i], *row = c + q * n;
            for (size_t j = 0; j <= i; ++j) p[j] -= factor * row[j];
        }
        p += i + 1;
    }
}

TALC_WIDE inline void add_scaled(double *TALC_ALONE to, const double *TALC_ALONE from, double factor, size_t n) {
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

// Of each mixture: gain := P x. Changes no covariance, so it needs no copy of them.
inline void mixtures_gain(Matrix mixed, Vector x, MatrixOut gain) {
    const size_t n = x.shape(0), errors = mixed.shape(0), packed = n * (n + 1) / 2;
    if (mixed.shape(1) != packed || gain.shape(0) != errors || gain.shape(1) != n)
        throw nb::value_error("mixtures: shapes do not fit together");
    nb::gil_scoped_release release;
    for (size_t j = 0; j < errors; ++j) packed_times(mixed.data() + j * packed, x.data(), gain.data() + j * n, n);
}

constexpr size_t widest = 16; // weights of one input

// The weights first..first+width-1 of one filter have `information` more about being zero (less, when negative).
inline void inform(double *p, double *mean, size_t first, size_t width, double information, size_t n,
                   std::vector<double> &column, std::vector<double> &gain, std::vector<double> &small) {
    column.resize(width * n);
    small.resize(width * width);
    for (size_t q = 0; q < width; ++q) {
        const size_t i = first + q;
        for (size_t j = 0; j <= i; ++j) column[q * n + j] = p[i * (i + 1) / 2 + j];
        for (size_t j = i + 1; j < n; ++j) column[q * n + j] = p[j * (j + 1) / 2 + i];
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
    double value[widest];
    for (size_t q = 0; q < width; ++q) value[q] = mean[first + q];
    for (size_t q = 0; q < width; ++q) add_scaled(mean, gain.data() + q * n, -value[q], n);
    packed_subtract(p, gain.data(), column.data(), width, n);
}

// One after the other: the filter which_k gets information_k about its weights first_k..first_k+width-1.
inline void filters_inform(MatrixOut covariance, MatrixOut mean, Integers which, Integers first, size_t width,
                           Vector information) {
    const size_t filters = covariance.shape(0), n = mean.shape(1), many = which.shape(0);
    if (covariance.shape(1) != n * (n + 1) / 2 || mean.shape(0) != filters || first.shape(0) != many ||
        information.shape(0) != many || width == 0 || width > widest)
        throw nb::value_error("filters: shapes do not fit together");
    for (size_t k = 0; k < many; ++k)
        if (which.data()[k] < 0 || static_cast<size_t>(which.data()[k]) >= filters || first.data()[k] < 0 ||
            static_cast<size_t>(first.data()[k]) + width > n || information.data()[k] == 0.0)
            throw nb::value_error("filters: no such filter or weight, or nothing to say");
    nb::gil_scoped_release release;
    std::vector<double> column, gain, small;
    for (size_t k = 0; k < many; ++k) {
        const size_t e = static_cast<size_t>(which.data()[k]);
        inform(covariance.data() + e * covariance.shape(1), mean.data() + e * n, static_cast<size_t>(first.data()[k]), width,
               information.data()[k], n, column, gain, small);
    }
}

// Prior variances of the given groups of one filter's weights (automatic relevance determination; MacKay, Neural
// Computation 4 (1992) 415-447): v = (sum of m^2 + k v0) / (sum of (1 - P / v0) + k), bounded, and the posterior that
// follows from it. rule: k, the least relative change that is made, the bounds of one renewal over v0 and over the first
// prior.
inline void renew(double *p, double *m, double *own, const double *first_own, const std::int64_t *groups, size_t many,
                  size_t width, const double *rule, size_t n, std::vector<double> &after, std::vector<double> &column,
                  std::vector<double> &gain, std::vector<double> &small) {
    after.resize(many);
    for (size_t l = 0; l < many; ++l) {
        const size_t first = static_cast<size_t>(groups[l]) * width;
        const double before = own[first], began = first_own[first];
        double square = 0.0, learnt = 0.0;
        for (size_t i = first; i < first + width; ++i) {
            square += m[i] * m[i];
            learnt += 1.0 - p[i * (i + 3) / 2] / before;
        }
        const double found = (square + rule[0] * before) / (std::max(learnt, 1e-3) + rule[0]);
        const double least = std::max(rule[4] * began, rule[2] * before);
        const double most = std::min(rule[5] * began, rule[3] * before);
        after[l] = std::min(std::max(found, least), most);
    }
    for (size_t l = 0; l < many; ++l) {
        const size_t first = static_cast<size_t>(groups[l]) * width;
        if (std::abs(after[l] / own[first] - 1.0) < rule[1]) continue;
        inform(p, m, first, width, 1.0 / after[l] - 1.0 / own[first], n, column, gain, small);
        for (size_t i = first; i < first + width; ++i) own[i] = after[l];
    }
}

// to := to + weight P; rows without variance are skipped.
TALC_WIDE inline void mix(double *TALC_ALONE to, const double *TALC_ALONE p, double weight, size_t n) {
    for (size_t i = 0; i < n; to += i + 1, p += ++i) {
        if (p[i] == 0.0) continue;
        for (size_t j = 0; j <= i; ++j) to[j] += weight * p[j];
    }
}

// After filters_look, of each filter: condition on an innovation seen with noise; of the filters `which`, renew the prior
// variances of `groups`; mixed := sum of weight_e P_e over the filters with at least `least` weight. All that is done to one
// covariance is done while it is in the cache. spread: x' P x.
inline void filters_learn(MatrixOut covariance, MatrixOut mean, Matrix gain, Vector spread, Vector innovation, double noise,
                          MatrixOut prior, Matrix first_prior, Integers which, Integers groups, size_t width, Vector rules,
                          Vector weight, double least, VectorOut mixed) {
    const size_t filters = covariance.shape(0), n = mean.shape(1), packed = n * (n + 1) / 2, many = groups.shape(0);
    if (covariance.shape(1) != packed || mean.shape(0) != filters || gain.shape(0) != filters || gain.shape(1) != n ||
        spread.shape(0) != filters || innovation.shape(0) != filters || !(noise > 0.0))
        throw nb::value_error("filters: shapes do not fit together, or no noise");
    if (prior.shape(0) != filters || prior.shape(1) != n || first_prior.shape(0) != filters || first_prior.shape(1) != n ||
        rules.shape(0) != 6 || width == 0 || width > widest || weight.shape(0) != filters || mixed.shape(0) != packed)
        throw nb::value_error("filters: shapes do not fit together");
    for (size_t k = 0; k < many; ++k)
        if (groups.data()[k] < 0 || (static_cast<size_t>(groups.data()[k]) + 1) * width > n)
            throw nb::value_error("filters: no such group of weights");
    std::vector<bool> renewed(filters, false);
    for (size_t k = 0; k < which.shape(0); ++k) {
        if (which.data()[k] < 0 || static_cast<size_t>(which.data()[k]) >= filters)
            throw nb::value_error("filters: no such filter");
        renewed[static_cast<size_t>(which.data()[k])] = true;
    }
    nb::gil_scoped_release release;
    std::vector<double> column, inverse, small, after;
    std::fill_n(mixed.data(), packed, 0.0);
    for (size_t e = 0; e < filters; ++e) {
        double *p = covariance.data() + e * packed, *m = mean.data() + e * n;
        const double *h = gain.data() + e * n;
        const double total = spread.data()[e] + noise;
        add_scaled(m, h, innovation.data()[e] / total, n);
        packed_downdate(p, h, total, n);
        if (renewed[e])
            renew(p, m, prior.data() + e * n, first_prior.data() + e * n, groups.data(), many, width, rules.data(), n, after,
                  column, inverse, small);
        if (weight.data()[e] >= least) mix(mixed.data(), p, weight.data()[e], n);
    }
}

// All filters in other units, in which some weights are a priori what they were in the old one: weight i becomes factor_i
// times itself; then the filter which_k gets information_k about its weights first_k..first_k+width-1 being zero; mixed as in
// filters_learn.
inline void filters_rescale(MatrixOut covariance, MatrixOut mean, Vector factor, Integers which, Integers first, size_t width,
                            Vector information, Vector weight, double least, VectorOut mixed) {
    const size_t filters = covariance.shape(0), n = mean.shape(1), packed = n * (n + 1) / 2;
    if (factor.shape(0) != n || weight.shape(0) != filters || mixed.shape(0) != packed)
        throw nb::value_error("filters: shapes do not fit together");
    for (size_t e = 0; e < filters; ++e) {
        double *p = covariance.data() + e * packed, *m = mean.data() + e * n;
        for (size_t i = 0; i < n; ++i) {
            m[i] *= factor.data()[i];
            for (size_t j = 0; j <= i; ++j) *p++ *= factor.data()[i] * factor.data()[j];
        }
    }
    filters_inform(covariance, mean, which, first, width, information);
    std::fill_n(mixed.data(), packed, 0.0);
    for (size_t e = 0; e < filters; ++e)
        if (weight.data()[e] >= least) mix(mixed.data(), covariance.data() + e * packed, weight.data()[e], n);
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
    std::vector<double> own(filters);
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
        predicted.data()[j] = centre;
        variance.data()[j] = packed_square(mixed.data() + j * packed, x.data(), n) + elapsed.data()[j] * drifted + apart;
    }
}

inline void bind_learner(nb::module_ &m) {
    m.def("filters_look", &filters_look, nb::arg("covariance"), nb::arg("growth"), nb::arg("x"), nb::arg("gain"),
          nb::arg("spread"), "Grow the covariances (filters, n (n + 1) / 2); gain := P x, spread := x' P x.");
    m.def("filters_learn", &filters_learn, nb::arg("covariance"), nb::arg("mean"), nb::arg("gain"), nb::arg("spread"),
          nb::arg("innovation"), nb::arg("noise"), nb::arg("prior"), nb::arg("first_prior"), nb::arg("which"),
          nb::arg("groups"), nb::arg("width"), nb::arg("rules"), nb::arg("weight"), nb::arg("least"), nb::arg("mixed"),
          "After filters_look: condition each filter on its innovation, estimate some prior variances of some filters "
          "again, and sum up the weighted covariances.");
    m.def("filters_inform", &filters_inform, nb::arg("covariance"), nb::arg("mean"), nb::arg("which"), nb::arg("first"),
          nb::arg("width"), nb::arg("information"),
          "Add information that some weights of some filters are zero; negative: take it away.");
    m.def("filters_rescale", &filters_rescale, nb::arg("covariance"), nb::arg("mean"), nb::arg("factor"), nb::arg("which"),
          nb::arg("first"), nb::arg("width"), nb::arg("information"), nb::arg("weight"), nb::arg("least"), nb::arg("mixed"),
          "Weights times factors, information about some of them, and the weighted sum of the covariances.");
    m.def("mixtures_predict", &mixtures_predict, nb::arg("mean"), nb::arg("weight"), nb::arg("mixed"), nb::arg("drift"),
          nb::arg("elapsed"), nb::arg("x"), nb::arg("predicted"), nb::arg("variance"),
          "Mean and variance of each error's mixture of filters.");
    m.def("mixtures_gain", &mixtures_gain, nb::arg("mixed"), nb::arg("x"), nb::arg("gain"),
          "Of each error, gain := P x with the mixture's covariance (errors, n (n + 1) / 2).");
}
}  // namespace talc
