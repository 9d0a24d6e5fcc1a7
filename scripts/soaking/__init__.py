"""What scripts/soak does to whole runs: length, kills, full disks, cold caches; every part yields rows."""
