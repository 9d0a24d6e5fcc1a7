"""How much of a file is taken before it is refused: bounds that no real recording meets, all in one place.

A recording is data from strangers. A few kilobytes can claim to be gigabytes, and be believed by a decoder;
so whatever allocates or loops by what a file says asks one of these first. SECURITY.md tells why.
"""

from __future__ import annotations

MIB = 1 << 20

# Compressed data

CHUNK_BYTES = 256 * MIB
"""Of one MCAP chunk when decompressed. Writers end chunks at 1 to 64 MiB, or after one larger message."""
EXPANSION_FLOOR_BYTES = 1024 * MIB
EXPANSION = 256
"""All chunks of an MCAP file decompress to at most the floor or so many times the file, whichever is more.

Blank depth images compress better than that, but not a whole recording of them.
"""
PENDING_BYTES = 512 * MIB
"""Of messages that wait for their turn because chunks overlap in time."""
BYTES_PER_RECORD = 4
SPARE_RECORDS = 16
"""A chunk holds at most one record for so many compressed bytes, and these: stamps differ, and cost more."""

# Pixels

IMAGE_PIXELS = 1 << 25
"""Of one image: 8K video has 33.2 million pixels."""

NEAREST_MM, FARTHEST_MM = 0.01, 1e7
"""A depth nearer or farther is no reading. No depth camera sees nearer than a millimetre or beyond 10 km."""

# Files that are read whole

TEXT_BYTES = 16 * MIB
"""Of a text file that is read whole: camera files, configurations, poses, stamps, clicked points."""
MESH_BYTES = 256 * MIB
"""Of a GLB file."""
IMAGE_BYTES = 512 * MIB
"""Of an image file: the largest image, without compression and with four channels of 32 bits."""
REPORT_BYTES = 256 * MIB
"""Of a JSON report given as baseline."""

# Arrays

NPZ_FLOOR_BYTES = 256 * MIB
NPZ_EXPANSION = 16
"""All arrays of an npz file take at most the floor or so many times the file; ours are not compressed."""
NPZ_ARRAYS = 100_000
"""In one npz file."""

# Messages that are not images

MESSAGE_BYTES = 16 * MIB
"""Of a calibration, a transform or an estimate."""

# Numbers and names in results

LENGTH_MM = 1e9
"""Of a position or a size: a thousand kilometres."""
NUMBER = 1e12
"""Of any other number, such as a velocity or a variance; squares and sums of such do not overflow."""
INTEGER = 2**63 - 1
NAME_CHARACTERS = 256
"""Of a joint, a shape entry or a camera."""
LIST_ENTRIES = 10_000
"""Points, shape entries or further numbers of one subject: a hand has 21 joints, a face some hundred."""
TRIANGLES = 1_000_000
"""Of a subject's mesh."""
CAMERAS = 1000
"""Of one rig."""

# Lines of text

LINE_BYTES = MIB
"""Of a line of a truth in CSV: a row of a thousand columns has some 20 kB."""
COLUMNS = 10_000
"""Of such a file."""
KEY_PARTS = 32
"""Of a dotted key in TOML, such as ``a.b.c``."""
