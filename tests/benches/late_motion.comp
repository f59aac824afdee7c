component late_motion "Lets the motion begin this late after LinuxCNC has confirmed the command, as a busy computer does now and then";
pin in float us = 200;
license "Apache-2.0";
option singleton yes;
function _;
;;
#include <time.h>
FUNCTION(_) {
    /* Asleep, not spinning: whoever else wants this core has it meanwhile, as after a preemption. */
    const struct timespec late = {0, (long)(us * 1000)};
    nanosleep(&late, NULL);
}
