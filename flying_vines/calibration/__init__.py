"""The calibration of a rig on the ground: its sensors, volumes, valves, leaks and bend curve.

`plan` lists the stages, `calibrator` is the state machine that runs them, `rig` connects it to a real or a
simulated rig. `evaluation` computes the `findings` of a stage from its `readings`: `vine_air` the volumes and
leaks, `valve` the valves. All this needs numpy and scipy. The page, the bend curve and the diagnosis need the
whole extra `analysis`.
"""
