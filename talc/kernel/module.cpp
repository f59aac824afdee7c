// Python bindings of TALC's compiled numerics.
#include <nanobind/nanobind.h>

#include "runner.hpp"
#include "group_lasso.hpp"
#include "lag.hpp"
#include "process.hpp"
#include "pso.hpp"
#include "search.hpp"

NB_MODULE(_kernel, m) {
    m.doc() = "Compiled numerics of TALC.";
    talc::bind_group_lasso(m);
    talc::bind_lag(m);
    talc::bind_process(m);
    talc::bind_pso(m);
    talc::bind_runner(m);
    talc::bind_search(m);
}
