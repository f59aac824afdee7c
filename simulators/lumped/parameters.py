"""The bodies of the bench's machine and what couples them, with the reasoning for each number.

A gantry-type five-axis machine of about 9 t: mineral-cast and iron bed, X slide carrying the A cradle with the C table,
column with Y and Z slides and a motor spindle. Iron 460 J/(kg K), mineral cast 900; films of still hall air 5-6, of
moving slides 8-10 W/(m² K); screwed joints 2000-4000 W/(m² K) over the touching area; ball bearings and nuts 3-15 W/K.
"""

from simulators.lumped.network import Link, Node

_IRON, _MINERAL, _WATER, _EMULSION, _AIR = 460.0, 900.0, 4180.0, 4000.0, 1005.0

NODES = (
    # name, kg, J/(kg K), m², W/(m² K), air. The bed's core is deep in the casting: no sensor sees it.
    Node("bed_core", 2600, _MINERAL, 0.0, 0.0, ""),
    Node("bed_front_left", 420, _MINERAL, 1.1, 5.0, "hall_low"),
    Node("bed_front_right", 420, _MINERAL, 1.1, 5.0, "hall_low"),
    Node("bed_rear_left", 420, _MINERAL, 1.0, 5.0, "hall_low"),
    Node("bed_rear_right", 420, _MINERAL, 1.0, 5.0, "hall_low"),
    Node("column_left", 650, _IRON, 1.6, 6.0, "hall_high"),
    Node("column_right", 650, _IRON, 1.6, 6.0, "hall_high"),
    Node("x_slide", 380, _IRON, 0.9, 8.0, "space"),
    Node("x_nut", 9, _IRON, 0.05, 10.0, "space"),
    Node("x_screw", 22, _IRON, 0.16, 15.0, "space"),  # turns, so a higher film; not sensed
    Node("a_cradle_left", 150, _IRON, 0.45, 8.0, "space"),
    Node("a_cradle_right", 150, _IRON, 0.45, 8.0, "space"),
    Node("a_drive", 55, _IRON, 0.25, 8.0, "space"),
    Node("c_table", 190, _IRON, 0.4, 9.0, "space"),
    Node("c_drive", 70, _IRON, 0.15, 6.0, "space"),
    Node("c_bearing", 14, _IRON, 0.0, 0.0, ""),  # inside the table's hub; not sensed
    Node("y_slide", 420, _IRON, 1.0, 8.0, "hall_high"),
    Node("y_nut", 9, _IRON, 0.05, 10.0, "hall_high"),
    Node("z_slide", 330, _IRON, 0.8, 8.0, "hall_high"),
    Node("z_nut", 9, _IRON, 0.05, 10.0, "hall_high"),
    Node("spindle_front", 32, _IRON, 0.12, 10.0, "space"),
    Node("spindle_rear", 28, _IRON, 0.12, 8.0, "hall_high"),
    Node("spindle_motor", 38, _IRON, 0.1, 6.0, "hall_high"),
    Node("spindle_shaft", 16, _IRON, 0.04, 25.0, "space"),  # turns; seen only through the eddy-current sensor
    Node("coolant", 25, _WATER, 0.3, 5.0, "hall_low"),  # spindle and C-drive circuit, 25 l
    Node("tank", 450, _EMULSION, 2.2, 6.0, "hall_low"),  # cutting fluid, 450 l: time constant hours
    Node("space", 6, _AIR + 4000, 2.5, 4.0, "hall_high"),  # air, sheet metal and chips of the working space
)

LINKS = (
    # The bed's corners on their core: mineral cast 2 W/(m K) · 1.2 m² / 0.15 m.
    *(Link("bed_core", f"bed_{p}", 16.0) for p in ("front_left", "front_right", "rear_left", "rear_right")),
    Link("bed_front_left", "bed_front_right", 4.0),
    Link("bed_rear_left", "bed_rear_right", 4.0),
    Link("bed_rear_left", "column_left", 60.0),  # flange 0.03 m² effective
    Link("bed_rear_right", "column_right", 60.0),
    Link("column_left", "column_right", 25.0),  # 50 W/(m K) · 0.3 m² / 0.6 m
    # X: slide on linear guides; nut flanged to the slide; screw touches the nut by balls, the bed by its bearings.
    Link("x_slide", "bed_front_left", 12.0),
    Link("x_slide", "bed_front_right", 12.0),
    Link("x_nut", "x_slide", 14.0),
    Link("x_screw", "x_nut", 6.0),
    Link("x_screw", "bed_front_right", 4.0),  # fixed bearing and motor flange
    # A cradle between two bearings on the slide, its drive on the left.
    Link("a_cradle_left", "x_slide", 15.0),
    Link("a_cradle_right", "x_slide", 15.0),
    Link("a_cradle_left", "a_cradle_right", 14.0),
    Link("a_drive", "a_cradle_left", 30.0),
    # C: drive in the cradle's bridge, table on the bearing.
    Link("c_drive", "a_cradle_left", 18.0),
    Link("c_drive", "a_cradle_right", 22.0),
    Link("c_bearing", "c_drive", 20.0),
    Link("c_bearing", "c_table", 25.0),
    Link("y_slide", "column_left", 14.0),
    Link("y_slide", "column_right", 14.0),
    Link("y_nut", "y_slide", 14.0),
    Link("z_slide", "y_slide", 22.0),
    Link("z_nut", "z_slide", 14.0),
    Link("spindle_front", "z_slide", 35.0),
    Link("spindle_rear", "z_slide", 30.0),
    Link("spindle_motor", "spindle_front", 12.0),
    Link("spindle_motor", "spindle_rear", 12.0),
    Link("spindle_shaft", "spindle_front", 10.0),  # through the bearings
    Link("spindle_shaft", "spindle_rear", 7.0),
    # Coolant jackets while the pump runs: h 800 · about 0.15 m². It always runs while the machine is on.
    Link("coolant", "spindle_motor", 130.0),
    Link("coolant", "spindle_front", 25.0),
    Link("coolant", "c_drive", 90.0),
    Link("coolant", "chiller", 450.0),  # keeps the flow about 2 K around its set point
    # Cutting fluid on: h 200-500 on the wetted surfaces; off: only the air (above).
    Link("tank", "c_table", 70.0, "cutting_fluid"),
    Link("tank", "a_cradle_left", 35.0, "cutting_fluid"),
    Link("tank", "a_cradle_right", 45.0, "cutting_fluid"),  # the jets come from the right
    Link("tank", "x_slide", 30.0, "cutting_fluid"),
    Link("tank", "space", 60.0, "cutting_fluid"),
    Link("tank", "spindle_front", 8.0, "cutting_fluid"),
    # A turning table and moving slides stir the air of the working space.
    Link("space", "c_table", 6.0, "stirring"),
    Link("space", "x_slide", 5.0, "stirring"),
)

BOUNDARIES = ("hall_low", "hall_high", "chiller")

EXPANSION_IRON = 10.5
"""Cast iron, µm/(m K)."""
EXPANSION_STEEL = 11.5
EXPANSION_MINERAL = 12.0

# Thermal errors as elastic consequences: sum of coefficient · (T - T at 0 s), µm (µm/m) per K. A length times an
# expansion unless said otherwise; a tilt is (height · expansion / distance) of two points, µm/m per K.
_I, _S, _M = EXPANSION_IRON, EXPANSION_STEEL, EXPANSION_MINERAL
ERROR_ROWS: dict[str, dict[str, float]] = {
    # A axis in Y: 0.10 m of bed front against rear support, less 0.06 m of Y slide overhang.
    "EY0A": {"bed_front_left": 0.05 * _M, "bed_front_right": 0.05 * _M, "y_slide": -0.06 * _I, "y_nut": -0.02 * _I},
    # A axis in Z: bed 0.40 m and slide 0.22 m lift it; column 0.55 m, Z slide and nut lift the spindle; the shaft and
    # housing bring the tool down again (0.16 m shaft, 0.12 m housing below the clamp).
    "EZ0A": {
        "bed_front_left": 0.10 * _M,
        "bed_front_right": 0.10 * _M,
        "bed_core": 0.20 * _M,
        "x_slide": 0.22 * _I,
        "column_left": -0.28 * _I,
        "column_right": -0.28 * _I,
        "z_slide": 0.10 * _I,
        "z_nut": 0.04 * _I,
        "spindle_front": 0.12 * _I,
        "spindle_shaft": 0.16 * _S,
    },
    # C axis in X: free length of the X screw 0.30 m, slide 0.15 m, cradle arms pushing against each other.
    "EX0C": {
        "x_screw": 0.30 * _S,
        "x_nut": 0.05 * _S,
        "x_slide": 0.15 * _I,
        "a_cradle_left": 0.16 * _I,
        "a_cradle_right": -0.16 * _I,
        "a_drive": 0.05 * _I,
        "bed_core": -0.10 * _M,
    },
    # C axis in Y: 0.04 m between A axis and table centre, and the drive's housing.
    "EY0C": {"c_drive": 0.03 * _I, "a_cradle_left": 0.02 * _I, "a_cradle_right": 0.02 * _I},
    # Table upwards: hub 0.14 m, drive 0.10 m, table 0.10 m.
    "EZ0T": {"c_bearing": 0.14 * _S, "c_drive": 0.10 * _I, "c_table": 0.10 * _I},
    # Table outwards at the sphere, 0.20 m; the bearing's ring pushes a little.
    "ER0T": {"c_table": 0.20 * _I, "c_bearing": 0.02 * _S},
    # About X: bed 0.5 m high, 1.1 m between front and rear; the A drive twists its bearing (0.02 m over 0.15 m).
    "EA0C": {
        "bed_front_left": 0.5 * _M / 2.2,
        "bed_front_right": 0.5 * _M / 2.2,
        "bed_rear_left": -0.5 * _M / 2.2,
        "bed_rear_right": -0.5 * _M / 2.2,
        "a_drive": 0.02 * _I / 0.15,
        "c_bearing": -0.01 * _S / 0.15,
    },
    # About Y: cradle arms 0.28 m high, 0.65 m apart; bed left against right.
    "EB0C": {
        "a_cradle_left": 0.28 * _I / 0.65,
        "a_cradle_right": -0.28 * _I / 0.65,
        "bed_front_left": 0.25 * _M / 1.3,
        "bed_front_right": -0.25 * _M / 1.3,
        "a_drive": 0.05 * _I / 0.65,
    },
    # Zero position of C: the reading head stands on the drive, 0.06 m from the axis, its ring on the hub.
    "EC0C": {"c_drive": 0.02 * _I / 0.06, "c_bearing": -0.012 * _S / 0.06, "a_cradle_right": -0.01 * _I / 0.06},
}

SPINDLE_GROWTH_ROW = {"spindle_shaft": 0.16 * EXPANSION_STEEL, "spindle_front": 0.05 * EXPANSION_IRON}
"""Elongation that the eddy-current sensor at the nose sees, µm/K; the housing beyond its holder it does not see."""

ROOT_GROWTH_UM = 6.0
"""The shaft also grows by centrifugal shift of its angular-contact bearings: µm at 18,000 1/min, with the square of
the speed (catalogue values 3-10 µm). At standstill, when the probe is in, it is gone."""
