component talc_errors "Offsets of X, Y, Z from nine thermal errors and from where the tool is";
description """
Evaluates the kinematics of a machine XYZAC in every servo period; see talc_errors.h. The nine errors are slewed, the
offsets are bounded. Without a beat for `silence` seconds the errors go to zero at `ramp`, and what was wanted until then
counts no more when beats come again. Nothing is in force before homing, and `homing_inhibit` keeps LinuxCNC from homing while something is: it would be swallowed.""";
license "Apache-2.0";
option singleton yes;

pin in float x_cmd "commanded position of the joint, in LINEAR_UNITS";
pin in float y_cmd;
pin in float z_cmd;
pin in float a_cmd "degrees";
pin in float tool_x "length of the tool in use, in LINEAR_UNITS";
pin in float tool_y;
pin in float tool_z;
pin in float ey0a "wanted, um";
pin in float ez0a;
pin in float ex0c;
pin in float ey0c;
pin in float ez0t;
pin in float er0t "at radius";
pin in float ea0c "um/m";
pin in float eb0c;
pin in float ec0c;
pin out float ey0a_in_force;
pin out float ez0a_in_force;
pin out float ex0c_in_force;
pin out float ey0c_in_force;
pin out float ez0t_in_force;
pin out float er0t_in_force;
pin out float ea0c_in_force;
pin out float eb0c_in_force;
pin out float ec0c_in_force;
pin out float x_offset "in LINEAR_UNITS";
pin out float y_offset;
pin out float z_offset;
pin out float x_held "offset while the program last said 2, in LINEAR_UNITS";
pin out float y_held;
pin out float z_held;
pin in float x_bound = 1e9 "um, either way; bound_um holds besides";
pin in float y_bound = 1e9;
pin in float z_bound = 1e9;
pin in bit is_homed "all axes";
pin in float request "number of the gateway's request for a probing cycle, 0: none";
pin in float answers "number of the request that the probing program has taken";
pin in float cycle "what the program says: 1 accepted, the errors stand still; 2 running, the offsets too";
pin in bit aside "the offsets go to zero, as before homing";
pin in bit by_hand "nobody sends beats: what is wanted is set by hand";
pin in bit beat "toggles with every beat";
pin in bit free "nobody has claimed the control";
pin in s32 of_lapse = -1 "the count of `lapse` for which the wanted errors are meant; otherwise what is in force stays";
pin out s32 lapse "how many times the watchdog has ended a claim, or a release has";
pin in float silence "s";
pin in float ramp "um/s, 0 holds";
pin out bit beat_seen;
pin out bit watching "beats arrive";
pin out bit homing_inhibit;
param rw float bound_um "either way";
param rw float slew_um_per_s;
param rw float unit_mm = 1 "mm in one of LINEAR_UNITS";
param rw float pivot_x "mm";
param rw float pivot_y;
param rw float pivot_z;
param rw float sphere_radius = 120 "mm, where er0t is";
param rw float reach_x "mm";
param rw float reach_yz;

variable double unheard = 1e9;
variable int past = 0;
variable TalcState state;

function _;
include "talc_errors.h";
;;
FUNCTION(_) {
    TalcInput in;
    const double mm = unit_mm, um = unit_mm * 1e3;
    const double wanted[TALC_ERRORS] = {ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c};
    const double bounds[3] = {x_bound, y_bound, z_bound};
    const int taken = request != 0 && request == answers && cycle > 0.5 && cycle < 2.5;
    const int touching = taken && cycle > 1.5;
    in.dt = period * 1e-9;
    unheard = beat != past ? 0.0 : unheard + in.dt;
    past = beat_seen = beat;
    const int watched = !free && unheard < silence;
    if (watching && !watched) lapse++;
    watching = watched;
    const int meant = by_hand || of_lapse == lapse;
    for (int i = 0; i < TALC_ERRORS; i++)
        in.wanted[i] = !(watching || by_hand) ? 0.0 : meant ? wanted[i] : state.errors[i];
    for (int i = 0; i < 3; i++) in.bound[i] = bounds[i] >= 0 && bounds[i] < bound_um ? bounds[i] : bound_um;
    in.limit = bound_um;
    in.tool[0] = tool_x * mm;
    in.tool[1] = tool_y * mm;
    in.tool[2] = tool_z * mm;
    in.tip[0] = x_cmd * mm - pivot_x - in.tool[0];
    in.tip[1] = y_cmd * mm - pivot_y - in.tool[1];
    in.tip[2] = z_cmd * mm - pivot_z - in.tool[2];
    in.a = a_cmd * (M_PI / 180.0);
    in.radius = sphere_radius;
    in.reach[0] = reach_x;
    in.reach[1] = reach_yz;
    in.slew = slew_um_per_s;
    in.rate = taken && watching ? 0.0 : watching || by_hand ? slew_um_per_s : ramp; /* the slew holds anyway */
    in.homed = is_homed && !aside;
    in.hold = touching && watching;
    talc_step(&state, &in);
    ey0a_in_force = state.errors[EY0A];
    ez0a_in_force = state.errors[EZ0A];
    ex0c_in_force = state.errors[EX0C];
    ey0c_in_force = state.errors[EY0C];
    ez0t_in_force = state.errors[EZ0T];
    er0t_in_force = state.errors[ER0T];
    ea0c_in_force = state.errors[EA0C];
    eb0c_in_force = state.errors[EB0C];
    ec0c_in_force = state.errors[EC0C];
    x_offset = state.out[0] / um;
    y_offset = state.out[1] / um;
    z_offset = state.out[2] / um;
    if (touching) {
        x_held = x_offset;
        y_held = y_offset;
        z_held = z_offset;
    }
    homing_inhibit = fabs(state.out[0]) + fabs(state.out[1]) + fabs(state.out[2]) > TALC_GONE_UM;
}
