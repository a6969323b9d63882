"""`flying-vines doctor`: checks whether you may fly, and shows what is wrong and how to correct it.

One file per subject: its facts, all lines that can be printed with their remedies, and the check. `examine`
runs all in order. The doctor sends no setpoint. It requests version, time and settings from the phloSAR
(the request for its version, Hello, vents the vine), and messages, parameters, version and mission from the
vehicle.

`radio_test` is a separate test, `doctor --radio`: is a lost transmitter detected? `radio_guide` leads the
user through it, and `radio` judges the result.
"""
