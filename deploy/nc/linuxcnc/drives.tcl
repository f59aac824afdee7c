# The control without hardware: each drive follows at once. Put your own here: x-drive is the command of X's drive, and
# the encoder's position goes to talc-fb-x.in0, or for a rotary axis to its joint's motor-pos-fb.
foreach row [split [exec /usr/bin/python3 ./talc_joints.py] "\n"] {
    lassign $row name axis joint
    if {$axis in {A C}} {
        net $name-drive => joint.$joint.motor-pos-fb
    } else {
        net $name-drive => talc-fb-$name.in0
    }
}
