"""Many recordings at once: each tracked in a process of its own, on one machine or on a cluster.

``jobs`` says what is to be done, ``records`` what was done before, ``performing`` does one job
where it runs, in a process of its own, ``engine`` gives jobs to Dask, ``running`` goes through a batch, and
``summary`` tells what came of it.
"""
