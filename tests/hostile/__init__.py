"""Hostile inputs: what strangers' files must not bring about, and the search for one that does.

``Case``          files and a command line (``case``)
``Harness``       runs a case in a child of a warm process, returns its ``Outcome`` (``running``, ``server``)
``violations``    what an outcome breaks of the invariant (``invariant``)
``seeds``         small valid recordings, results, states and models, made by the program itself
``TARGETS``       strategies of cases: seeds with fields, records and bytes changed (``targets``)
``fuzz``          the endless search; ``scripts/fuzz --minutes M`` calls it

``test_corpus`` holds one small file for every attack that once worked, ``test_targets`` some hundred cases of
the search, the same in every run, ``test_invariant`` shows that every violation is seen. A case that
``scripts/fuzz --keep`` kept is run again with ``scripts/fuzz --again FOLDER``. What the search finds gets a
test of its own where the mistake was, and a case in ``test_corpus`` where it is a new way of attacking.

The invariant: exit code 0, 1, 2 or 3; on failure exactly one line ``posetrack: ...`` on standard error,
beside which there are only the forms that commands remark something in; no traceback, no warning, no control
character of a file on either stream; at most 1 GiB above the idle process and 5 s of CPU beyond what valid
input takes; no file made or changed but the output; nothing imported, no process started, no connection made.
"""
