#pragma once
#include <atomic>

#include "arrays.hpp"

namespace talc {

// What a long call tells the thread that waits for it, and how that thread stops it.
class Progress {
   public:
    void cancel() { cancelled_.store(true, std::memory_order_relaxed); }
    bool cancelled() const { return cancelled_.load(std::memory_order_relaxed); }
    double share() const { return share_.load(std::memory_order_relaxed); }
    void report(double share) { share_.store(share, std::memory_order_relaxed); }

   private:
    std::atomic<bool> cancelled_{false};
    std::atomic<double> share_{0.0};
};

inline void bind_progress(nb::module_ &m) {
    nb::class_<Progress>(m, "Progress", "Of one long call: share done, and a way to stop it from another thread.")
        .def(nb::init<>())
        .def("cancel", &Progress::cancel, "Ask the call to end early.")
        .def_prop_ro("cancelled", &Progress::cancelled)
        .def_prop_ro("share", &Progress::share, "0 to 1.");
}
}  // namespace talc
