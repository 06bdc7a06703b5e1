"""A suite that measures whether a driver, and this package on it, follows the specifications.

Run it with `solari-vk conformance`. Every check measures something and holds it against a bar; the report has a row a
rule, with the document and section that the rule is from. The table of groups.py names all checks. What a device can't
do is named as unsupported; faults of drivers that are known are listed with their evidence in known_faults.toml, and
the run fails when a fault that is listed there no longer occurs.

run.py starts a child process for each group (children.py), in which a worker (worker.py) measures checks and tells
each outcome at once. A crash, a hang or a lost device is an outcome of the check during which it happens; a new child
measures the rest. `pytest --pyargs solari_vk.lab.conformance` measures all checks as tests, by one worker in its
process.
"""
