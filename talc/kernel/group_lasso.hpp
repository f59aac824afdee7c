#pragma once
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "linear.hpp"

namespace talc {

struct LassoResult {
    double objective = 0.0, gap = 0.0;
    size_t passes = 0, newton = 0;
};

// min t'Gt - 2 m't + e + penalty sum_s sqrt(g_s) ||t_s||  (Z22 eq. 8 on the Gram matrix, unpenalised columns projected
// out before). Thermal regressors are close to collinear: block descent alone needs tens of thousands of passes. A few
// passes find the support, Newton's method with Cholesky and backtracking finishes on it, the duality gap decides.
class GroupLasso {
   public:
    // The leading `size[s]` columns of each of the groups that begin at `first[s]`; groups of size 0 are left out.
    void load(const double *gram, size_t stride, const double *moment, double energy, const std::vector<size_t> &first,
              const std::vector<size_t> &size) {
        columns_.clear(), start_.clear(), weight_.clear(), slope_.clear();
        for (size_t s = 0; s < first.size(); ++s) {
            if (!size[s]) continue;
            start_.push_back(columns_.size());
            weight_.push_back(std::sqrt(static_cast<double>(size[s])));
            double trace = 0.0;
            for (size_t j = 0; j < size[s]; ++j) {
                columns_.push_back(first[s] + j);
                trace += gram[(first[s] + j) * stride + first[s] + j];
            }
            slope_.push_back(2.0 * trace);
        }
        start_.push_back(columns_.size());
        p_ = columns_.size(), energy_ = energy;
        gram_.resize(p_ * p_), moment_.resize(p_), theta_.assign(p_, 0.0), image_.assign(p_, 0.0);
        for (size_t i = 0; i < p_; ++i) {
            const double *row = gram + columns_[i] * stride;
            for (size_t j = 0; j < p_; ++j) gram_[i * p_ + j] = row[columns_[j]];
            moment_[i] = moment[columns_[i]];
        }
    }

    // Smallest penalty that leaves nothing.
    double largest() const {
        double top = 0.0;
        for (size_t s = 0; s + 1 < start_.size(); ++s)
            top = std::max(top, 2.0 * norm(moment_.data() + start_[s], start_[s + 1] - start_[s]) / weight_[s]);
        return top;
    }

    void warm(const double *theta) {
        std::copy(theta, theta + p_, theta_.begin());
        refresh();
    }

    LassoResult solve(double penalty, double tolerance, size_t limit) {
        LassoResult result;
        shy_.assign(start_.size(), 1);
        for (size_t round = 0; round < limit; ++round) {
            // All groups may enter; then only the support moves.
            pass(penalty, false), ++result.passes;
            for (int k = 0; k < kPasses; ++k) pass(penalty, true), ++result.passes;
            for (int k = 0; k < kNewtonSteps; ++k) {
                ++result.newton;
                if (!newton(penalty) || gap(penalty, result.objective) <= 0.1 * tolerance) break;
            }
            refresh();
            result.gap = gap(penalty, result.objective);
            if (result.gap <= tolerance) break;
        }
        return result;
    }

    const std::vector<double> &theta() const { return theta_; }
    const std::vector<size_t> &starts() const { return start_; }
    const std::vector<size_t> &columns() const { return columns_; }

   private:
    // Between two looks at the groups outside the support (medians over thermal problems; more of either is slower).
    static constexpr int kPasses = 3, kNewtonSteps = 8;
    static constexpr double kShrinking = 0.8;

    static double norm(const double *x, size_t n) {
        double s = 0.0;
        for (size_t i = 0; i < n; ++i) s += x[i] * x[i];
        return std::sqrt(s);
    }

    void refresh() {
        std::fill(image_.begin(), image_.end(), 0.0);
        for (size_t j = 0; j < p_; ++j) {
            if (theta_[j] == 0.0) continue;
            const double *row = gram_.data() + j * p_;
            for (size_t i = 0; i < p_; ++i) image_[i] += row[i] * theta_[j];
        }
    }

    void move(size_t j, double by) {
        if (by == 0.0) return;
        theta_[j] += by;
        const double *row = gram_.data() + j * p_;
        for (size_t i = 0; i < p_; ++i) image_[i] += row[i] * by;
    }

    // One pass of block steps; with `support_only` groups at zero stay there.
    void pass(double penalty, bool support_only) {
        double target[64];
        for (size_t s = 0; s + 1 < start_.size(); ++s) {
            const size_t a = start_[s], n = start_[s + 1] - a;
            const double own = norm(theta_.data() + a, n), lambda = penalty * weight_[s];
            if (support_only && own == 0.0) continue;
            if (alone(s) <= lambda) {
                if (own != 0.0) drop(s);
                continue;
            }
            double length = 0.0;
            for (size_t i = 0; i < n; ++i) {
                target[i] = theta_[a + i] + 2.0 * (moment_[a + i] - image_[a + i]) / slope_[s];
                length += target[i] * target[i];
            }
            length = std::sqrt(length);
            const double shrink = std::max(0.0, 1.0 - lambda / (slope_[s] * length));
            for (size_t i = 0; i < n; ++i) move(a + i, shrink * target[i] - theta_[a + i]);
        }
    }

    // Groups of the support whose best value is zero are set to it. True: there was one.
    bool leave(double penalty) {
        bool left = false;
        for (size_t s = 0; s + 1 < start_.size(); ++s) {
            const size_t a = start_[s], n = start_[s + 1] - a;
            if (norm(theta_.data() + a, n) == 0.0 || alone(s) > penalty * weight_[s]) continue;
            drop(s);
            left = true;
        }
        return left;
    }

    // Length of a group's gradient when its own part is taken out; inside the ball of the penalty its best value is zero.
    double alone(size_t s) const {
        const size_t a = start_[s], n = start_[s + 1] - a;
        double square = 0.0;
        for (size_t i = 0; i < n; ++i) {
            double c = moment_[a + i] - image_[a + i];
            const double *row = gram_.data() + (a + i) * p_ + a;
            for (size_t j = 0; j < n; ++j) c += row[j] * theta_[a + j];
            square += c * c;
        }
        return 2.0 * std::sqrt(square);
    }

    void drop(size_t s) {
        for (size_t i = start_[s]; i < start_[s + 1]; ++i) {
            move(i, -theta_[i]);
            theta_[i] = 0.0;
        }
    }

    double objective(const double *theta, const double *image, double penalty) const {
        double value = energy_;
        for (size_t i = 0; i < p_; ++i) value += theta[i] * (image[i] - 2.0 * moment_[i]);
        for (size_t s = 0; s + 1 < start_.size(); ++s)
            value += penalty * weight_[s] * norm(theta + start_[s], start_[s + 1] - start_[s]);
        return value;
    }

    // One step on the support. False: converged, or no step lowers the objective.
    bool newton(double penalty) {
        support_.clear(), group_.clear();
        for (size_t s = 0; s + 1 < start_.size(); ++s)
            if (norm(theta_.data() + start_[s], start_[s + 1] - start_[s]) > 0.0)
                for (size_t i = start_[s]; i < start_[s + 1]; ++i) support_.push_back(i), group_.push_back(s);
        const size_t m = support_.size();
        if (!m) return false;
        hessian_.resize(m * m), step_.resize(m);
        double scale = 0.0;
        for (size_t i = 0; i < m; ++i) scale = std::max(scale, gram_[support_[i] * p_ + support_[i]]);
        for (size_t i = 0; i < m; ++i) {
            const double *row = gram_.data() + support_[i] * p_;
            for (size_t j = i; j < m; ++j) hessian_[i * m + j] = 2.0 * row[support_[j]];
        }
        for (size_t i = 0; i < m; ++i) {
            const size_t a = support_[i], s = group_[i];
            const double r = norm(theta_.data() + start_[s], start_[s + 1] - start_[s]);
            const double bend = penalty * weight_[s] / r, along = shy_[s] ? 0.0 : bend / (r * r);
            for (size_t j = i; j < m && group_[j] == s; ++j)
                hessian_[i * m + j] -= along * theta_[a] * theta_[support_[j]];
            // Collinear columns need the last term; only the step, never the optimum, depends on it.
            hessian_[i * m + i] += bend + 1e-13 * scale;
            step_[i] = -(2.0 * (image_[a] - moment_[a]) + bend * theta_[a]);
        }
        double steepness = 0.0;
        gradient_ = step_;
        if (!cholesky(hessian_.data(), m)) return false;
        cholesky_solve(hessian_.data(), m, step_.data());
        for (size_t i = 0; i < m; ++i) steepness += gradient_[i] * step_[i];
        const double before = objective(theta_.data(), image_.data(), penalty);
        if (!(steepness > 1e-28 * std::abs(before))) return false;
        turn_.assign(p_, 0.0);
        for (size_t i = 0; i < m; ++i) {
            const double *row = gram_.data() + support_[i] * p_;
            for (size_t j = 0; j < p_; ++j) turn_[j] += row[j] * step_[i];
        }
        // So near the optimum the objective's rounding hides the descent; Newton's own convergence does not need it.
        const bool near = steepness < 1e-10 * std::abs(before);
        trial_ = theta_, trial_image_ = image_;
        for (double share = 1.0; share > 1e-6; share *= 0.5) {
            for (size_t i = 0; i < m; ++i) trial_[support_[i]] = theta_[support_[i]] + share * step_[i];
            for (size_t j = 0; j < p_; ++j) trial_image_[j] = image_[j] + share * turn_[j];
            if (near || objective(trial_.data(), trial_image_.data(), penalty) <= before - 1e-4 * share * steepness) {
                restrain(share);
                theta_ = trial_, image_ = trial_image_;
                return leave(penalty) || steepness > 1e-22 * std::abs(before);
            }
        }
        return false;
    }

    // Newton's model of a norm ends at zero, where a group on its way out makes the whole step short. Such groups get the
    // quadratic majorant ||t|| <= (||t||^2 / r + r) / 2 for the next step, which never overshoots.
    void restrain(double share) {
        std::fill(shy_.begin(), shy_.end(), 0);
        if (share == 1.0) return;
        for (size_t i = 0; i < support_.size();) {
            const size_t s = group_[i], a = start_[s], n = start_[s + 1] - a;
            double length = 0.0, along = 0.0;
            for (size_t q = 0; q < n; ++q, ++i) {
                length += theta_[a + q] * theta_[a + q];
                along += theta_[a + q] * step_[i];
            }
            shy_[s] = along < -kShrinking * length;
        }
    }

    // Primal minus dual value relative to the primal; the dual point is the residual, scaled until it is feasible.
    double gap(double penalty, double &primal) const {
        double fit = 0.0, misfit = energy_, worst = 0.0, penalties = 0.0;
        for (size_t i = 0; i < p_; ++i) {
            fit += theta_[i] * moment_[i];
            misfit += theta_[i] * (image_[i] - 2.0 * moment_[i]);
        }
        misfit = std::max(misfit, 0.0);
        for (size_t s = 0; s + 1 < start_.size(); ++s) {
            double c = 0.0;
            for (size_t i = start_[s]; i < start_[s + 1]; ++i) {
                const double d = moment_[i] - image_[i];
                c += d * d;
            }
            worst = std::max(worst, 2.0 * std::sqrt(c) / weight_[s]);
            penalties += weight_[s] * norm(theta_.data() + start_[s], start_[s + 1] - start_[s]);
        }
        primal = misfit + penalty * penalties;
        const double scale = worst > penalty ? penalty / worst : 1.0;
        const double dual = 2.0 * scale * (energy_ - fit) - scale * scale * misfit;
        return primal > 0.0 ? std::max(primal - dual, 0.0) / primal : 0.0;
    }

    size_t p_ = 0;
    double energy_ = 0.0;
    std::vector<size_t> columns_, start_, support_, group_;
    std::vector<char> shy_;
    std::vector<double> weight_, slope_, gram_, moment_, theta_, image_, hessian_, step_, gradient_, turn_, trial_,
        trial_image_;
};

inline void bind_group_lasso(nb::module_ &m) {
    m.def(
        "group_lasso",
        [](Matrix gram, Vector moment, double energy, std::vector<size_t> first, std::vector<size_t> size,
           double penalty, double tolerance, size_t limit, VectorOut theta) {
            LassoResult result;
            {
                nb::gil_scoped_release release;
                GroupLasso solver;
                solver.load(gram.data(), gram.shape(1), moment.data(), energy, first, size);
                std::vector<double> packed(solver.columns().size());
                for (size_t i = 0; i < packed.size(); ++i) packed[i] = theta.data()[solver.columns()[i]];
                solver.warm(packed.data());
                result = solver.solve(penalty, tolerance, limit);
                std::fill(theta.data(), theta.data() + theta.shape(0), 0.0);
                for (size_t i = 0; i < packed.size(); ++i) theta.data()[solver.columns()[i]] = solver.theta()[i];
            }
            return std::make_tuple(result.objective, result.gap, result.passes, result.newton);
        },
        nb::arg("gram"), nb::arg("moment"), nb::arg("energy"), nb::arg("first"), nb::arg("size"), nb::arg("penalty"),
        nb::arg("tolerance"), nb::arg("limit"), nb::arg("theta"), "objective, gap, passes, newton; theta in place");
}
}  // namespace talc
