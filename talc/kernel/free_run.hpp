#pragma once
#include <cstddef>

#include "arrays.hpp"

namespace talc {

// y[k] = -sum_{i=1..na} a_i y[k-i] + drive[k], held inside [low, high]. Where y_measured[k] is finite, a state update
// shifts the whole history by gains[age] (y_measured[k] - y[k]), age = steps since the last one (last gain: older).
// y_out receives the prediction made at k, before the update; history (most recent first) is left as after row n-1.
// Returns the age after the last row.
inline size_t free_run(Vector a, Vector drive, Vector y_measured, Vector gains, double low, double high, size_t age,
                       VectorOut history, VectorOut y_out) {
    const size_t n = drive.shape(0), na = a.shape(0), n_gains = gains.shape(0);
    const double *pa = a.data(), *pd = drive.data(), *pm = y_measured.data(), *pg = gains.data();
    double *h = history.data(), *out = y_out.data();
    nb::gil_scoped_release release;
    for (size_t k = 0; k < n; ++k) {
        double y = pd[k];
        for (size_t i = 0; i < na; ++i) y -= pa[i] * h[i];
        y = y < low ? low : (y > high ? high : y);
        out[k] = y;
        for (size_t i = na; i-- > 1;) h[i] = h[i - 1];
        if (na > 0) h[0] = y;
        ++age;
        if (pm[k] == pm[k]) {
            const double shift = pg[(age < n_gains ? age : n_gains) - 1] * (pm[k] - y);
            for (size_t i = 0; i < na; ++i) h[i] += shift;
            age = 0;
        }
    }
    return age;
}

inline void bind_free_run(nb::module_ &m) {
    m.def("free_run", &free_run, nb::arg("a"), nb::arg("drive"), nb::arg("y_measured"), nb::arg("gains"),
          nb::arg("low"), nb::arg("high"), nb::arg("age"), nb::arg("history"), nb::arg("y_out"),
          "Simulate with state updates, in place; see talc.models for the checked interface.");
}
}  // namespace talc
