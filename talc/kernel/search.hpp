#pragma once
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <unordered_map>
#include <vector>

#include "linear.hpp"

namespace talc {

// Inputs of a model and their orders: one byte per offered input, 0 absent, else its number of coefficients.
using Set = std::string;

// The regression of one output on one design (one choice of poles), rows in blocks. Columns come input by input, lags
// coefficients each, then `fixed` ones that every model has. Grams and moments are sums over each block's rows.
class BlockedRegression {
   public:
    BlockedRegression(const double *gram, const double *moment, const double *energy, size_t blocks, size_t inputs,
                      size_t lags, size_t fixed, double ridge)
        : gram_(gram), moment_(moment), energy_(energy), blocks_(blocks), inputs_(inputs), lags_(lags),
          p_(inputs * lags + fixed), ridge_(ridge), total_(p_ * p_, 0.0), sum_(p_, 0.0) {
        for (size_t b = 0; b < blocks_; ++b) {
            for (size_t i = 0; i < p_ * p_; ++i) total_[i] += gram_[b * p_ * p_ + i];
            for (size_t i = 0; i < p_; ++i) sum_[i] += moment_[b * p_ + i];
        }
    }

    // Sum of squares that fits leave on the block they did not see; infinity when a fit is singular. The first block is
    // always seen: only there the decay of the unknown first state shows.
    double unseen(const Set &set) {
        gather(set);
        double squares = 0.0;
        for (size_t b = 1; b < blocks_; ++b) {
            const double *gram = gram_ + b * p_ * p_, *moment = moment_ + b * p_;
            if (!solve(gram, moment)) return std::numeric_limits<double>::infinity();
            squares += left(gram, moment, energy_[b]);
        }
        return squares;
    }

    // Sum of squares that the fit on all rows leaves.
    double seen(const Set &set) {
        gather(set);
        if (!solve(nullptr, nullptr)) return std::numeric_limits<double>::infinity();
        double energy = 0.0;
        for (size_t b = 0; b < blocks_; ++b) energy += energy_[b];
        return left(total_.data(), sum_.data(), energy);
    }

   private:
    void gather(const Set &set) {
        columns_.clear();
        for (size_t s = 0; s < inputs_; ++s)
            for (size_t j = 0; j < static_cast<size_t>(set[s]); ++j) columns_.push_back(s * lags_ + j);
        penalised_ = columns_.size();
        for (size_t c = inputs_ * lags_; c < p_; ++c) columns_.push_back(c);
        const size_t m = columns_.size();
        matrix_.resize(m * m);
        theta_.resize(m);
    }

    // Ridge regression on all rows but the given block's.
    bool solve(const double *without, const double *less) {
        const size_t m = columns_.size();
        for (size_t i = 0; i < m; ++i) {
            const size_t row = columns_[i] * p_;
            for (size_t j = i; j < m; ++j) {
                const size_t at = row + columns_[j];
                matrix_[i * m + j] = total_[at] - (without ? without[at] : 0.0);
            }
            matrix_[i * m + i] += i < penalised_ ? ridge_ : 1e-9 * (1.0 + total_[row + columns_[i]]);
            theta_[i] = sum_[columns_[i]] - (less ? less[columns_[i]] : 0.0);
        }
        if (!cholesky(matrix_.data(), m)) return false;
        cholesky_solve(matrix_.data(), m, theta_.data());
        return true;
    }

    double left(const double *gram, const double *moment, double energy) const {
        const size_t m = columns_.size();
        double squares = energy;
        for (size_t i = 0; i < m; ++i) {
            const double *row = gram + columns_[i] * p_;
            double image = 0.5 * row[columns_[i]] * theta_[i];
            for (size_t j = 0; j < i; ++j) image += row[columns_[j]] * theta_[j];
            squares += 2.0 * theta_[i] * (image - moment[columns_[i]]);
        }
        return std::max(squares, 0.0);
    }

    const double *gram_, *moment_, *energy_;
    size_t blocks_, inputs_, lags_, p_;
    double ridge_;
    std::vector<double> total_, sum_, matrix_, theta_;
    std::vector<size_t> columns_;
    size_t penalised_ = 0;
};

// Best set from some first ones by single steps: an input less, more, exchanged, an order up or down.
// cost = rows ln(max(squares, floor) / rows) + price (poles + orders + inputs); ties keep the earlier set.
class SetSearch {
   public:
    SetSearch(BlockedRegression &regression, bool unseen, double rows, double price, double floor, size_t poles,
              size_t most, size_t lags)
        : regression_(regression), unseen_(unseen), rows_(rows), price_(price), floor_(floor), poles_(poles),
          most_(most), lags_(lags) {}

    double cost(const Set &set) {
        const auto known = known_.find(set);
        if (known != known_.end()) return known->second;
        const double squares = unseen_ ? regression_.unseen(set) : regression_.seen(set);
        double terms = static_cast<double>(poles_);
        for (char coefficients : set) terms += coefficients;
        const double value =
            std::isfinite(squares) ? rows_ * std::log(std::max(squares, floor_) / rows_) + price_ * terms : 1e300;
        known_.emplace(set, value);
        return value;
    }

    // With fixed inputs only their orders are stepped.
    Set best(Set set, bool fixed_inputs) {
        for (;;) {
            Set next = set;
            double least = cost(set);
            const auto consider = [&](const Set &other) {
                const double value = cost(other);
                if (value < least) least = value, next = other;
            };
            const size_t used = static_cast<size_t>(set.size() - std::count(set.begin(), set.end(), '\0'));
            for (size_t s = 0; s < set.size(); ++s) {
                Set other = set;
                if (set[s]) {
                    for (int step : {-1, 1}) {
                        const int order = set[s] + step;
                        if (order < 1 || order > static_cast<int>(lags_)) continue;
                        other[s] = static_cast<char>(order);
                        consider(other);
                    }
                    if (fixed_inputs) continue;
                    other[s] = 0;
                    consider(other);
                    for (size_t t = 0; t < set.size(); ++t) {
                        if (set[t]) continue;
                        other[t] = set[s];
                        consider(other);
                        other[t] = 0;
                    }
                } else if (!fixed_inputs && used < most_) {
                    for (size_t order = 1; order <= std::min<size_t>(lags_, 2); ++order) {
                        other[s] = static_cast<char>(order);
                        consider(other);
                    }
                }
            }
            if (next == set) return set;
            set = next;
        }
    }

   private:
    BlockedRegression &regression_;
    bool unseen_;
    double rows_, price_, floor_;
    size_t poles_, most_, lags_;
    std::unordered_map<Set, double> known_;
};

// One whole selection; see talc.papers.search for the checked interface. Returns the index of the design, each offered
// input's number of coefficients (0: not chosen), and the cost.
inline std::tuple<size_t, std::vector<int>, double> search(Stack4 gram, Stack3 moment, Vector energy, Integers poles,
                                                           std::vector<std::vector<std::vector<int>>> starts,
                                                           size_t inputs, size_t lags, double ridge, bool unseen,
                                                           double rows, double price, double floor, size_t most,
                                                           bool fixed_inputs) {
    nb::gil_scoped_release release;
    const size_t designs = gram.shape(0), blocks = gram.shape(1), p = gram.shape(2);
    size_t chosen = 0;
    Set answer(inputs, '\0');
    double least = std::numeric_limits<double>::infinity();
    for (size_t d = 0; d < designs; ++d) {
        BlockedRegression regression(gram.data() + d * blocks * p * p, moment.data() + d * blocks * p, energy.data(),
                                     blocks, inputs, lags, p - inputs * lags, ridge);
        SetSearch search(regression, unseen, rows, price, floor, static_cast<size_t>(poles.data()[d]), most, lags);
        Set first(inputs, '\0');
        double first_cost = std::numeric_limits<double>::infinity();
        for (const auto &start : starts[d]) {
            Set set(start.begin(), start.end());
            const double value = search.cost(set);
            if (value < first_cost) first_cost = value, first = set;
        }
        const Set found = search.best(first, fixed_inputs);
        const double value = search.cost(found);
        if (value < least) least = value, answer = found, chosen = d;
    }
    return {chosen, std::vector<int>(answer.begin(), answer.end()), least};
}

inline void bind_search(nb::module_ &m) {
    m.def("search", &search, nb::arg("gram"), nb::arg("moment"), nb::arg("energy"), nb::arg("poles"),
          nb::arg("starts"), nb::arg("inputs"), nb::arg("lags"), nb::arg("ridge"), nb::arg("unseen"), nb::arg("rows"),
          nb::arg("price"), nb::arg("floor"), nb::arg("most"), nb::arg("fixed_inputs"),
          "Deterministic search for inputs, orders and poles; see talc.papers.search.");
}
}  // namespace talc
