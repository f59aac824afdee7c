component late_motion "Lets the motion begin this late after LinuxCNC has confirmed the command, as a busy computer does now and then";
pin in float us = 200;
license "Apache-2.0";
option singleton yes;
function _;
;;
FUNCTION(_) {
    const long long end = rtapi_get_time() + (long long)(us * 1000);
    while (rtapi_get_time() < end) continue;
}
