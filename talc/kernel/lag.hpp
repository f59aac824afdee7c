#pragma once
#include "arrays.hpp"

namespace talc {

// Each column through 1 / (1 - pole q^-1), in place; before its first row a column stood at that row's value.
inline void lag(MatrixOut columns, double pole) {
    const size_t n = columns.shape(0), width = columns.shape(1);
    double *x = columns.data();
    nb::gil_scoped_release release;
    if (!n) return;
    for (size_t c = 0; c < width; ++c) x[c] /= 1.0 - pole;
    for (size_t k = 1; k < n; ++k)
        for (size_t c = 0; c < width; ++c) x[k * width + c] += pole * x[(k - 1) * width + c];
}

inline void bind_lag(nb::module_ &m) {
    m.def("lag", &lag, nb::arg("columns"), nb::arg("pole"), "First-order filter of each column, in place.");
}
}  // namespace talc
