"""Programs for those who develop Robbie-MP, in rooms.

- trials: what robots and parts of them do over many seeds, judged by the truth; `python -m tools.trials`
- bench: how fast messages are, beside other middleware
- load: what the logger costs the modules
- kill_campaign, link, operator, ros1, standstill: what remains promised while processes die and networks fail
- fuzz: hostile modules and damaged bytes
- docs, pictures: what makes the website, its generated page and its pictures
- arm64: the wheel and the tests with an emulated ARM processor
- wheels.py: the wheels of a release

`test_network` and `loop_disk.py` make hosts with a bad network, and a disk that can be frozen, also for
tests; `robot.py` starts a robot under test.
"""
