# The compensation: added to the command behind the interpolator, taken out of the feedback, so that the control's own
# positions, soft limits and following error do not see it, and an emergency stop leaves it as it is.
# The component talc_errors works it out from the nine errors and from where the tool is, bounds and slews it, whatever is
# wanted. By hand, without the agent: halcmd setp talc-errors.ex0c 5 moves the tool 5 um in plus X.
# axis.*.eoffset is not used: emergency stop and power-off set it to zero in one step.
# Which joints an axis has is in the INI file: a gantry gets the offset on both. An INI file that talc_joints.py does
# not understand ends LinuxCNC here, with a message.
set rows [split [exec /usr/bin/python3 ./talc_joints.py] "\n"]
loadrt talc_errors
foreach row [split [exec /usr/bin/python3 ./talc_joints.py values] "\n"] {
    lassign $row name value
    setp talc-errors.$name $value
}
addf talc-errors servo-thread
setp talc-errors.by-hand 1
net talc-homed motion.is-all-homed => talc-errors.is-homed
# Homing takes what is in force for zero: LinuxCNC refuses to home until it is gone. talc-errors.aside takes it back.
net talc-homing-inhibit talc-errors.homing-inhibit => motion.homing-inhibit
set sums {}
foreach row $rows {
    lassign $row name axis joint
    set letter [string tolower $axis]
    if {$axis in {X Y Z}} {
        lappend sums talc-cmd-$name talc-fb-$name
    }
    if {$name eq $letter && $axis ne "C"} {
        net talc-$name-cmd joint.$joint.pos-cmd => talc-errors.$name-cmd
    }
}
loadrt sum2 names=[join $sums ,]
foreach axis {x y z} {
    net talc-tool-$axis motion.tooloffset.$axis => talc-errors.tool-$axis
    net talc-$axis-in-force talc-errors.$axis-offset
}
foreach row $rows {
    lassign $row name axis joint
    # To the drive goes x-drive (x2-drive: the second joint of a gantry), see drives.tcl.
    if {$axis in {A C}} {
        net $name-drive joint.$joint.motor-pos-cmd
        continue
    }
    setp talc-fb-$name.gain1 -1
    addf talc-cmd-$name servo-thread
    addf talc-fb-$name servo-thread
    net talc-[string tolower $axis]-in-force => talc-cmd-$name.in1 talc-fb-$name.in1
    net $name-cmd joint.$joint.motor-pos-cmd => talc-cmd-$name.in0
    net $name-drive talc-cmd-$name.out
    net $name-fb talc-fb-$name.out => joint.$joint.motor-pos-fb
}
