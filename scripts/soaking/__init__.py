"""Parts of scripts/soak: long runs, kills, full disks, cold caches; each yields rows of one table."""
