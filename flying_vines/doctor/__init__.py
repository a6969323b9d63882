"""`flying-vines doctor`: may one fly, and if not, what is wrong and what is to be done about it?

`look/` and the two probes gather facts of this machine, the vehicle and the phloSAR; `checks/` are pure and
make findings of them; `examine` does both in order; `show` prints. Nothing here moves anything: the phloSAR
is greeted, asked for the time and for its settings; the vehicle for its messages, version and mission.

`radio_test` is another examination, `doctor --radio`: what shows when the transmitter goes off. `radio_guide`
leads through it, `checks/receiver` judges, `radio_command` prints and writes what was learned.
"""
