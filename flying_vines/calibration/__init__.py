"""The calibration of a rig on the ground: its sensors, volumes, valves, leaks and bend curve.

`plan` lists the stages, `calibrator` is the state machine that runs them, `driver` connects it to a real or a
simulated rig. `evaluation` computes the `findings` of a stage from its `readings`. All this needs numpy. The
page, the bend curve and the diagnosis need the whole extra `analysis`.
"""
