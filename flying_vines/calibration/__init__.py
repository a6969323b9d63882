"""The calibration of a rig on the ground: its sensors, volumes, valves, leaks and bend curve.

`plan` lists the stages, `calibrator` is the state machine that runs them, `driver` connects it to a real or a
simulated rig. `evaluation` makes the `readings` of a stage into `findings`. Only page, curve and diagnosis
need the extra `analysis`.
"""
