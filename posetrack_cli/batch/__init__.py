"""Batch tracking of many recordings, one process per recording, on one machine or a Dask cluster.

``sources`` lists the recordings, ``jobs`` defines jobs and outcomes, ``records`` stores them between runs,
``execution`` runs one job in a child process, ``engine`` submits jobs to Dask, ``scheduling`` runs a
batch, and ``summary`` evaluates the results.
"""
