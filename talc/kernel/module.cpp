// Python bindings of TALC's compiled numerics.
#include <nanobind/nanobind.h>

#include "free_run.hpp"

NB_MODULE(_kernel, m) {
    m.doc() = "Compiled numerics of TALC.";
    talc::bind_free_run(m);
}
