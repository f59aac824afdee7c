#pragma once
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "group_lasso.hpp"

namespace talc {

// One output's ARX regression for every autoregressive order: Grams with [intercept, y[k-1..k-na]] projected out, and
// what brings those coefficients back.
struct ArxProblem {
    size_t inputs, lags, orders;          // lags: coefficients of the largest nb; orders: largest na
    const double *gram, *moment, *energy;  // (orders + 1, P, P), (orders + 1, P), (orders + 1)
    const double *own, *across;            // (orders + 1, 1 + orders), (orders + 1, 1 + orders, P)
    const double *u, *y;                   // (T, inputs), (T) with NaN where not measured
    size_t rows;
    size_t most;                           // inputs that a model may have
};

// A candidate's free run and what it costs; see talc.papers.criteria.
class ArxCandidate {
   public:
    ArxCandidate(const ArxProblem &problem, int criterion, double scale, double tolerance, double safety)
        : p_(problem), criterion_(criterion), scale_(scale), tolerance_(tolerance), safety_(safety),
          first_(problem.inputs), size_(problem.inputs), own_(1 + problem.orders) {
        for (size_t s = 0; s < p_.inputs; ++s) first_[s] = s * p_.lags;
    }

    // log_share: ln(lambda / lambda_max); nb: orders per input.
    double cost(double log_share, size_t na, const int *nb) {
        const size_t P = p_.inputs * p_.lags;
        for (size_t s = 0; s < p_.inputs; ++s) size_[s] = static_cast<size_t>(nb[s]) + 1;
        lasso_.load(p_.gram + na * P * P, P, p_.moment + na * P, p_.energy[na], first_, size_);
        penalty = std::exp(log_share) * lasso_.largest();
        gap = lasso_.solve(penalty, 1e-8, 100).gap;
        const auto &theta = lasso_.theta();
        const auto &columns = lasso_.columns();
        double *a = own_.data();
        for (size_t i = 0; i <= na; ++i) {
            a[i] = p_.own[na * (1 + p_.orders) + i];
            const double *row = p_.across + (na * (1 + p_.orders) + i) * P;
            for (size_t c = 0; c < columns.size(); ++c) a[i] -= row[columns[c]] * theta[c];
        }
        used_.clear();
        size_t orders = na, chosen = 0, parameters = na;
        for (size_t s = 0, c = 0; s < p_.inputs; c += size_[s], ++s) {
            bool any = false;
            for (size_t j = 0; j < size_[s]; ++j) any = any || theta[c + j] != 0.0;
            if (!any) continue;
            ++chosen, orders += size_[s] - 1, parameters += size_[s];
            for (size_t j = 0; j < size_[s]; ++j) used_.push_back({s, j, theta[c + j]});
        }
        return chosen > p_.most ? 1e9 : judge(a, na, orders, chosen, parameters);
    }

    double penalty = 0.0, gap = 0.0;

   private:
    struct Term {
        size_t input, lag;
        double coefficient;
    };

    double judge(const double *a, size_t na, size_t orders, size_t chosen, size_t parameters) {
        const size_t begin = std::max(p_.lags - 1, p_.orders), T = p_.rows;
        run_.assign(T, 0.0);
        for (size_t k = 0; k < begin && k < T; ++k) run_[k] = p_.y[k] == p_.y[k] ? p_.y[k] : (k ? run_[k - 1] : 0.0);
        double squares = 0.0, worst = 0.0, n = 0.0;
        for (size_t k = begin; k < T; ++k) {
            double y = a[0];
            for (size_t i = 1; i <= na; ++i) y += a[i] * run_[k - i];
            for (const Term &t : used_) y += t.coefficient * p_.u[(k - t.lag) * p_.inputs + t.input];
            if (!(std::abs(y) < 1e6)) return 1e9;
            run_[k] = y;
            if (p_.y[k] == p_.y[k]) {
                const double e = (p_.y[k] - y) * scale_;
                squares += e * e, worst = std::max(worst, std::abs(e)), n += 1.0;
            }
        }
        if (n == 0.0) return 1e9;
        const double log_n = std::log(n), d = static_cast<double>(parameters);
        double value = 0.0;
        switch (criterion_) {
            case 0:
                value = log_n * static_cast<double>(orders + chosen * chosen) +
                        n * std::log(std::max(squares, 1.0)) * std::max(1.0, worst / (safety_ * tolerance_));
                break;
            case 1: value = n * std::log(std::max(squares / n, 1e-300)) + d * log_n; break;
            case 2: value = n * std::log(std::max(squares / n, 1e-300)) + 2.0 * d; break;
            default: value = squares / n * (1.0 + d * log_n / n);
        }
        return std::min(value, 1e9);
    }

    const ArxProblem &p_;
    int criterion_;
    double scale_, tolerance_, safety_;
    std::vector<size_t> first_, size_;
    std::vector<double> own_;
    std::vector<Term> used_;
    std::vector<double> run_;
    GroupLasso lasso_;
};

// Particle swarm over (ln(lambda / lambda_max), na, nb_1 .. nb_N), orders rounded. draws: uniform, (1 + iterations, swarm,
// 2, 2 + N); the first row of the first block places the particles.
inline std::tuple<double, std::vector<int>, double, double> pso(
    Stack3 gram, Matrix moment, Vector energy, Matrix own, Stack3 across, Matrix u, Vector y, size_t lags,
    int criterion, double scale, double tolerance, double safety, double least_log_share, size_t most, Stack4 draws,
    double pull, double inertia_first, double inertia_last) {
    nb::gil_scoped_release release;
    const size_t N = u.shape(1), orders = gram.shape(0) - 1, D = N + 2;
    const size_t swarm = draws.shape(1), iterations = draws.shape(0) - 1;
    const ArxProblem problem{N, lags, orders, gram.data(), moment.data(), energy.data(), own.data(), across.data(),
                             u.data(), y.data(), u.shape(0), most};
    ArxCandidate candidate(problem, criterion, scale, tolerance, safety);
    std::vector<double> low(D, 0.0), high(D, static_cast<double>(lags) - 1.0);
    low[0] = least_log_share, high[0] = 0.0, high[1] = static_cast<double>(orders);
    const auto draw = [&](size_t t, size_t i, size_t which, size_t d) {
        return draws.data()[((t * swarm + i) * 2 + which) * D + d];
    };
    std::vector<double> x(swarm * D), v(swarm * D), mine(swarm * D), cost(swarm, 1e300), best(D);
    std::vector<int> nb(N);
    double least = 1e300, gap = 0.0;
    for (size_t t = 0; t <= iterations; ++t) {
        const double done = iterations ? static_cast<double>(t) / static_cast<double>(iterations) : 1.0;
        const double inertia = inertia_first + (inertia_last - inertia_first) * done;
        for (size_t i = 0; i < swarm; ++i) {
            double *xi = x.data() + i * D, *vi = v.data() + i * D, *own_best = mine.data() + i * D;
            for (size_t d = 0; d < D; ++d) {
                const double range = high[d] - low[d];
                if (!t) {
                    xi[d] = low[d] + draw(0, i, 0, d) * range;
                    vi[d] = (draw(0, i, 1, d) - 0.5) * range;
                    continue;
                }
                vi[d] = inertia * vi[d] + pull * draw(t, i, 0, d) * (own_best[d] - xi[d]) +
                        pull * draw(t, i, 1, d) * (best[d] - xi[d]);
                vi[d] = std::clamp(vi[d], -0.5 * range, 0.5 * range);
                xi[d] += vi[d];
                if (xi[d] < low[d] || xi[d] > high[d]) xi[d] = std::clamp(xi[d], low[d], high[d]), vi[d] = 0.0;
            }
            for (size_t s = 0; s < N; ++s) nb[s] = static_cast<int>(std::lround(xi[2 + s]));
            const double value = candidate.cost(xi[0], static_cast<size_t>(std::lround(xi[1])), nb.data());
            if (value < cost[i]) cost[i] = value, std::copy(xi, xi + D, own_best);
            if (value < least) least = value, gap = candidate.gap, std::copy(xi, xi + D, best.begin());
        }
    }
    std::vector<int> found(N + 1);
    for (size_t d = 0; d <= N; ++d) found[d] = static_cast<int>(std::lround(best[1 + d]));
    return {best[0], found, least, gap};
}

inline void bind_pso(nb::module_ &m) {
    m.def("pso", &pso, nb::arg("gram"), nb::arg("moment"), nb::arg("energy"), nb::arg("own"), nb::arg("across"),
          nb::arg("u"), nb::arg("y"), nb::arg("lags"), nb::arg("criterion"), nb::arg("scale"), nb::arg("tolerance"),
          nb::arg("safety"), nb::arg("least_log_share"), nb::arg("most"), nb::arg("draws"), nb::arg("pull"), nb::arg("inertia_first"),
          nb::arg("inertia_last"), "Particle swarm over penalty and orders; see talc.papers.pso.");
}
}  // namespace talc
