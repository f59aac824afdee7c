# The compensation: added to the command behind the interpolator, taken out of the feedback, so that the control's own
# positions, soft limits and following error do not see it, and an emergency stop leaves it as it is.
# limit2 bounds and slews it here too, whatever is written to talc-x, talc-y, talc-z (LINEAR_UNITS of the INI file).
# axis.*.eoffset is not used: emergency stop and power-off set it to zero in one step.
# Which joints an axis has is in the INI file: a gantry gets the offset on both. An INI file that talc_joints.py does
# not understand ends LinuxCNC here, with a message.
set rows [split [exec /usr/bin/python3 ./talc_joints.py] "\n"]
loadrt limit2 names=talc-limit-x,talc-limit-y,talc-limit-z
foreach axis {x y z} {
    setp talc-limit-$axis.min $::TALC(LOWER)
    setp talc-limit-$axis.max $::TALC(BOUND)
    setp talc-limit-$axis.maxv $::TALC(SLEW)
    addf talc-limit-$axis servo-thread
    newsig talc-$axis float
    net talc-$axis => talc-limit-$axis.in
    net talc-$axis-in-force talc-limit-$axis.out
}
set sums {}
foreach row $rows {
    lassign $row name axis joint
    if {$axis ni {A C}} {
        lappend sums talc-cmd-$name talc-fb-$name
    }
}
loadrt sum2 names=[join $sums ,]
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
