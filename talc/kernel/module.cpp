// Python bindings of TALC's compiled numerics.
#include <nanobind/nanobind.h>

#include "runner.hpp"
#include "group_lasso.hpp"
#include "lag.hpp"
#include "process.hpp"
#include "pso.hpp"
#include "search.hpp"

NB_MODULE(_kernel, m) {
    // A thread that still holds a model when the process ends leaks nothing: the system takes all of it back.
    nanobind::set_leak_warnings(false);
    m.doc() = "Compiled numerics of TALC.";
    talc::bind_group_lasso(m);
    talc::bind_lag(m);
    talc::bind_process(m);
    talc::bind_pso(m);
    talc::bind_runner(m);
    talc::bind_search(m);
}
