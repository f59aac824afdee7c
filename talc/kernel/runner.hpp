#pragma once
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "arrays.hpp"

namespace talc {

// One model at work. Inputs are held inside their bounds and scaled; past outputs are the model's own (free run):
//   y[k] = intercept - sum_i a_i y[k-i] + sum_s sum_j b_sj u_s[k-j]; the prediction is y[k] + offset.
// A measurement either moves all past outputs by the residual (state update of Z22), or moves the offset: a disturbance
// of unknown pole and drift, followed by a bank of scalar Kalman filters, one for each candidate, whose weights are
// their likelihoods so far (multiple-model estimation, Magill 1965).
class Runner {
   public:
    Runner(Vector a, std::vector<std::vector<double>> b, double intercept, Vector u_mean, Vector u_std, Vector u_low,
           Vector u_high, double y_mean, double y_std, double y_low, double y_high, bool resets_history, double spread,
           Matrix leverage, double leverage_limit, double novelty_std, Vector pole, Vector drift, double noise,
           Vector weight)
        : a_(copy(a)), b_(std::move(b)), intercept_(intercept), u_mean_(copy(u_mean)), u_std_(copy(u_std)),
          u_low_(copy(u_low)), u_high_(copy(u_high)), y_mean_(y_mean), y_std_(y_std), y_low_(y_low), y_high_(y_high),
          resets_history_(resets_history), spread_(spread),
          leverage_(leverage.data(), leverage.data() + leverage.size()), leverage_limit_(leverage_limit),
          novelty_std_(novelty_std), pole_(copy(pole)), drift_(copy(drift)), noise_(noise),
          history_(a_.size(), 0.0), offset_(pole_.size(), 0.0), variance_(pole_.size(), y_std * y_std),
          weight_(copy(weight)) {
        size_t coefficients = 0;
        for (const auto &row : b_) lags_ = std::max(lags_, row.size()), coefficients += row.size();
        if (leverage_.size() != coefficients * coefficients) throw nb::value_error("leverage: not one row per coefficient");
        filtered_.assign(coefficients * std::max<size_t>(a_.size(), 1), 0.0);
    }

    // All past outputs, in physical units.
    void start(double y) { std::fill(history_.begin(), history_.end(), (y - y_mean_) / y_std_); }

    // One step on: the row of the model's inputs, and the measurement (NaN: none). `learn`: weigh the filters by it.
    // predicted, corrected, sigma, novelty (above 1: beyond what training saw), bounded.
    std::tuple<double, double, double, double, bool> step(const double *inputs, double measured, bool learn) {
        const bool first = u_.empty();
        bool held = push(inputs);
        const double leverage = filter(first);
        const double beyond = novelty_std_ * novelty_std_ * std::max(leverage - leverage_limit_, 0.0);
        const double novelty = leverage_limit_ > 0.0 ? leverage / leverage_limit_ : 0.0;
        double y = intercept_;
        for (size_t i = 0; i < a_.size(); ++i) y -= a_[i] * history_[i];
        const size_t n = b_.size();
        for (size_t s = 0; s < n; ++s)
            for (size_t j = 0; j < b_[s].size(); ++j) y += b_[s][j] * u_[j * n + s];
        double value = y * y_std_ + y_mean_;
        const double inside = bound(value);
        held = held || inside != value;
        value = inside;
        remember((value - y_mean_) / y_std_);

        for (size_t i = 0; i < pole_.size(); ++i) {
            offset_[i] *= pole_[i];
            variance_[i] = pole_[i] * pole_[i] * variance_[i] + drift_[i] * drift_[i];
        }
        auto [offset, variance] = mixture();
        const double predicted = bound(value + offset);
        if (!(measured == measured)) return {predicted, predicted, sigma(variance, beyond), novelty, held};
        if (resets_history_ && !a_.empty()) {
            const double shift = (measured - predicted) / y_std_;
            for (double &h : history_) h += shift;
            return {predicted, measured, sigma(variance, beyond), novelty, held};
        }
        update(measured - value, learn);
        std::tie(offset, variance) = mixture();
        return {predicted, bound(value + offset), sigma(variance, 0.0), novelty, held};
    }

    // Everything that changes from step to step, and back.
    std::vector<std::vector<double>> state() const { return {history_, u_, filtered_, offset_, variance_, weight_}; }
    void restore(const std::vector<std::vector<double>> &state) {
        const size_t filters = pole_.size();
        if (state.size() != 6 || state[0].size() != history_.size() ||
            !(state[1].empty() || state[1].size() == lags_ * b_.size()) || state[2].size() != filtered_.size() ||
            state[3].size() != filters || state[4].size() != filters || state[5].size() != filters)
            throw nb::value_error("state: not one of this model");
        history_ = state[0], u_ = state[1], filtered_ = state[2];
        offset_ = state[3], variance_ = state[4], weight_ = state[5];
    }

    size_t inputs() const { return b_.size(); }

   private:
    static std::vector<double> copy(Vector v) { return {v.data(), v.data() + v.shape(0)}; }

    double bound(double y) const { return y < y_low_ ? y_low_ : (y > y_high_ ? y_high_ : y); }
    double sigma(double variance, double beyond) const {
        return std::sqrt((pole_.empty() ? spread_ * spread_ : variance) + beyond);
    }

    // The scaled row becomes the newest; before the first one the inputs stood still. True: one was out of bounds.
    bool push(const double *inputs) {
        const size_t n = b_.size();
        bool held = false;
        row_.resize(n);
        for (size_t s = 0; s < n; ++s) {
            const double u = inputs[s] < u_low_[s] ? u_low_[s] : (inputs[s] > u_high_[s] ? u_high_[s] : inputs[s]);
            held = held || u != inputs[s];
            row_[s] = (u - u_mean_[s]) / u_std_[s];
        }
        if (u_.empty())
            for (size_t j = 0; j < lags_; ++j) u_.insert(u_.end(), row_.begin(), row_.end());
        std::copy_backward(u_.begin(), u_.end() - static_cast<std::ptrdiff_t>(n), u_.end());
        std::copy(row_.begin(), row_.end(), u_.begin());
        return held;
    }

    // Regressors of the free run, filtered by 1 / (1 + a_1 q^-1 + ...), and their leverage x' (X'X / n)^-1 x.
    double filter(bool first) {
        const size_t n = b_.size(), orders = std::max<size_t>(a_.size(), 1), p = filtered_.size() / orders;
        now_.resize(p);
        double gain = 1.0;
        for (double a : a_) gain += a;
        for (size_t s = 0, c = 0; s < n; ++s) {
            for (size_t j = 0; j < b_[s].size(); ++j, ++c) {
                double x = u_[j * n + s];
                if (first) x /= gain;
                else
                    for (size_t i = 0; i < a_.size(); ++i) x -= a_[i] * filtered_[i * p + c];
                now_[c] = x;
            }
        }
        if (p) std::copy_backward(filtered_.begin(), filtered_.end() - static_cast<std::ptrdiff_t>(p), filtered_.end());
        std::copy(now_.begin(), now_.end(), filtered_.begin());
        for (size_t i = 1; first && i < orders; ++i)
            std::copy(now_.begin(), now_.end(), filtered_.begin() + static_cast<std::ptrdiff_t>(i * p));
        double leverage = 0.0;
        for (size_t c = 0; c < p; ++c)
            for (size_t d = 0; d < p; ++d) leverage += now_[c] * leverage_[c * p + d] * now_[d];
        return leverage;
    }

    void remember(double y) {
        if (history_.empty()) return;
        std::copy_backward(history_.begin(), history_.end() - 1, history_.end());
        history_[0] = y;
    }

    // Mean and variance over the filters.
    std::tuple<double, double> mixture() const {
        if (pole_.empty()) return {0.0, 0.0};
        const double top = *std::max_element(weight_.begin(), weight_.end());
        double total = 0.0, mean = 0.0, square = 0.0;
        for (size_t i = 0; i < pole_.size(); ++i) {
            const double w = std::exp(weight_[i] - top);
            total += w, mean += w * offset_[i], square += w * (variance_[i] + offset_[i] * offset_[i]);
        }
        mean /= total;
        return {mean, std::max(square / total - mean * mean, 0.0)};
    }

    void update(double measured, bool learn) {
        for (size_t i = 0; i < pole_.size(); ++i) {
            const double innovation = measured - offset_[i], spread = variance_[i] + noise_ * noise_;
            if (learn) weight_[i] -= 0.5 * (std::log(spread) + innovation * innovation / spread);
            const double gain = spread > 0.0 ? variance_[i] / spread : 1.0;
            offset_[i] += gain * innovation;
            variance_[i] *= 1.0 - gain;
        }
        if (learn && !weight_.empty()) {
            const double top = *std::max_element(weight_.begin(), weight_.end());
            for (double &w : weight_) w -= top;
        }
    }

    std::vector<double> a_;
    std::vector<std::vector<double>> b_;
    double intercept_;
    std::vector<double> u_mean_, u_std_, u_low_, u_high_;
    double y_mean_, y_std_, y_low_, y_high_;
    bool resets_history_;
    double spread_;
    std::vector<double> leverage_;
    double leverage_limit_, novelty_std_;
    std::vector<double> pole_, drift_;
    double noise_;
    std::vector<double> history_, offset_, variance_, weight_;
    size_t lags_ = 1;
    std::vector<double> u_, row_, filtered_, now_;
};

inline void bind_runner(nb::module_ &m) {
    nb::class_<Runner>(m, "Runner", "One model's state; see talc.models and talc.papers.free_running.")
        .def(nb::init<Vector, std::vector<std::vector<double>>, double, Vector, Vector, Vector, Vector, double, double,
                      double, double, bool, double, Matrix, double, double, Vector, Vector, double, Vector>(),
             nb::arg("a"), nb::arg("b"), nb::arg("intercept"), nb::arg("u_mean"), nb::arg("u_std"), nb::arg("u_low"),
             nb::arg("u_high"), nb::arg("y_mean"), nb::arg("y_std"), nb::arg("y_low"), nb::arg("y_high"),
             nb::arg("resets_history"), nb::arg("spread"), nb::arg("leverage"), nb::arg("leverage_limit"), nb::arg("novelty_std"), nb::arg("pole"), nb::arg("drift"), nb::arg("noise"),
             nb::arg("weight"))
        .def("start", &Runner::start, nb::arg("y"), "Set all past outputs; physical units.")
        .def(
            "step",
            [](Runner &self, Vector inputs, double measured, bool learn) {
                if (inputs.shape(0) != self.inputs()) throw nb::value_error("inputs: expected one per input of the model");
                return self.step(inputs.data(), measured, learn);
            },
            nb::arg("inputs"), nb::arg("measured"), nb::arg("learn"), "predicted, corrected, sigma, novelty, bounded")
        .def(
            "run",
            [](Runner &self, Matrix inputs, Vector measured, bool learn, VectorOut predicted) {
                const size_t n = inputs.shape(0);
                if (inputs.shape(1) != self.inputs() || measured.shape(0) != n || predicted.shape(0) != n)
                    throw nb::value_error("run: shapes of inputs, measured and predicted do not fit");
                const double *u = inputs.data(), *y = measured.data();
                double *out = predicted.data();
                const size_t width = inputs.shape(1);
                nb::gil_scoped_release release;
                for (size_t k = 0; k < n; ++k) out[k] = std::get<0>(self.step(u + k * width, y[k], learn));
            },
            nb::arg("inputs"), nb::arg("measured"), nb::arg("learn"), nb::arg("predicted"), "`step` over rows.")
        .def("state", &Runner::state)
        .def("restore", &Runner::restore, nb::arg("state"));
}
}  // namespace talc
