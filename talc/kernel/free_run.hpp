#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace talc {
namespace nb = nanobind;

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using VectorOut = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// y[k] = -sum_{i=1..na} a_i y[k-i] + drive[k]; where y_measured[k] is finite it replaces y[k] in the history
// (a state update). y_out receives the prediction made at k before the replacement.
inline void free_run(Vector a, Vector drive, Vector y_measured, VectorOut history, VectorOut y_out) {
    const size_t n = drive.shape(0), na = a.shape(0);
    const double *pa = a.data(), *pd = drive.data(), *pm = y_measured.data();
    double *h = history.data(), *out = y_out.data();
    nb::gil_scoped_release release;
    for (size_t k = 0; k < n; ++k) {
        double y = pd[k];
        for (size_t i = 0; i < na; ++i) y -= pa[i] * h[i];
        out[k] = y;
        const double kept = (pm[k] == pm[k]) ? pm[k] : y;
        for (size_t i = na; i-- > 1;) h[i] = h[i - 1];
        if (na > 0) h[0] = kept;
    }
}

inline void bind_free_run(nb::module_ &m) {
    m.def("free_run", &free_run, nb::arg("a"), nb::arg("drive"), nb::arg("y_measured"), nb::arg("history"),
          nb::arg("y_out"),
          "Simulate y[k] = -sum a_i y[k-i] + drive[k] in place; see talc.models for the checked interface.");
}
}  // namespace talc
