"""Resource limits for untrusted files, well above anything a real recording needs.

A few kilobytes can claim to be gigabytes once decoded, so every allocation or loop whose size comes from a
file is checked against one of these first. See SECURITY.md.
"""

from __future__ import annotations

MIB = 1 << 20

# Compressed data

CHUNK_BYTES = 128 * MIB
"""One decompressed MCAP chunk. Writers end chunks at 1 to 64 MiB, or after one larger message."""
RECORD_BYTES = 1024 * MIB
"""One stored MCAP record, such as an attachment, which is read whole."""
EXPANSION_FLOOR_BYTES = 1024 * MIB
EXPANSION = 256
"""All chunks of an MCAP file decompress to at most the floor or this multiple of the file size.

Single blank depth images compress better than this, whole recordings do not.
"""
PENDING_BYTES = 512 * MIB
"""Messages buffered for reordering because chunks overlap in time."""
BYTES_PER_RECORD = 2
SPARE_RECORDS = 16
"""A chunk may hold one record per ``BYTES_PER_RECORD`` compressed bytes, plus this many.

Empty messages at 1 kHz of simulated time compress to 2.8 bytes each (zstd 19); with real stamps to 5 or more.
"""

BAG_HEAD_BYTES = MIB
"""Header of one ROS 1 bag record: a few names and numbers."""
DATABASE_STEPS_PER_BYTE, SPARE_DATABASE_STEPS = 4, 1_000_000
"""SQLite virtual machine steps per query: per byte of a ROS 2 database, plus the spare ones.

A row takes ten steps and at least 30 stored bytes.
"""
DEFINITION_BYTES = 64 * MIB
CHANNEL_BYTES = 4 * MIB
"""All distinct schemas, and all distinct channels, in an MCAP file.

A thousand ROS 2 topics take 1 MiB as channels (with quality of service) and 20 MiB as schemas.
"""
CHANNELS = 65_535
"""Channels in a written MCAP file: ids have 16 bits."""
SUMMARY_BYTES = 256 * MIB
"""Index of an MCAP file, which is read whole: 2 million chunks."""
MESSAGES = 1 << 40
"""Message count in an index: 35 years at 1 kHz."""

# Pixels

IMAGE_PIXELS = 1 << 25
"""One image; an 8K video frame has 33.2 million pixels."""
JPEG_SCANS = 30
"""Scans of a progressive JPEG, each of which covers the whole image; encoders write about ten."""
TILE_PIXELS = 1 << 22
"""One TIFF tile, decoded whole even for a tiny image; writers use 128 to 1024 squared."""

TIFF_PAGES = 1 << 20
"""Pages, i.e. frames, of one TIFF: ten hours at 30 Hz."""

NEAREST_MM, FARTHEST_MM = 0.01, 1e7
"""Range of valid depth readings; no depth camera measures below 1 mm or beyond 10 km."""

# Files that are read whole

TEXT_BYTES = 16 * MIB
"""Text files: cameras, configurations, poses, stamps, clicked points."""
MESH_BYTES = 256 * MIB
"""GLB files."""
IMAGE_BYTES = 512 * MIB
"""Image files: the largest image, uncompressed, with four 32-bit channels."""
REPORT_BYTES = 256 * MIB
"""JSON reports used as baseline."""
KEYPOINT_BYTES = 256 * MIB
"""External keypoints in CSV or JSON Lines, read line by line: an hour takes 50 MB."""
KEYPOINT_JSON_BYTES = 32 * MIB
"""External keypoints in one JSON value, which takes up to 25 times its size in memory: 15 minutes."""
KEYPOINT_SETS = 250_000
"""Hands, and frames, in a keypoint file: two hours at 30 Hz."""

# Meshes: a hand has about a thousand points and 25 joints, a full character ten times as many

MESH_NODES = 10_000
MESH_JOINTS = 512
MESH_POINTS = 250_000
"""All parts of a skinned mesh; hand scans have a tenth of it."""
MESH_TRIANGLES = 500_000
MESH_WEIGHTS = 1 << 24
"""Points times joints: each point has a weight per joint."""
MESH_VALENCE = 2_000
"""Triangles at one point, including the centre of a closed hole; decimation is quadratic in it."""
MESH_REACH = 1e6
"""Coordinates, lengths and scales in file units: a kilometre in millimetres."""

# Arrays

MODEL_BYTES = 256 * MIB
"""Files of face models or learned head models; a hundred people's templates take less."""
MODEL_TRIAL_S = 60
MODEL_TRIAL_BYTES = 2048 * MIB
"""Time and address space for loading a face detector; YuNet takes a second and 0.9 GiB."""
FACE_PARAMETERS = 256
"""Identity, and deformation, parameters; morphable models have up to 199 and 29."""
FACES = 6
GUESSES = 60
"""Faces per image that get landmarks (the largest ``FACES``) out of the most confident detections.

Landmarks take 0.1 s per face, and a damaged network can report thousands of faces.
"""
NPZ_FLOOR_BYTES = 256 * MIB
NPZ_EXPANSION = 16
"""All arrays of an npz file take at most the floor or this multiple of the file's size."""
PEOPLE = 5_000
"""People seen by one camera in a recording: a video cut may start a new one."""
NPZ_ARRAYS = 100_000
"""Arrays in one npz file."""

# Messages that are not images

MESSAGE_BYTES = 1 * MIB
"""One calibration, transform or estimate message; a thousand transforms take 0.15 MiB."""
DEFINITION_CHARACTERS = 1 * MIB
"""ROS message definition including nested types; the longest standard one has 20,000 characters."""
TRANSFORMS = 20_000
TRANSFORM_BYTES = 16 * MIB
"""Transforms read from a file, by count and size."""

# Frames inserted by exports

EXPORT_FRAMES = 10_000
EXPORT_EXPANSION = 16
"""Frames of an export at a fixed rate, which fills gaps between estimates.

At most ``EXPORT_FRAMES`` (five minutes at 30 Hz) or this multiple of the estimates, whichever is more.
"""

# Numbers and names in results

LENGTH_MM = 1e9
"""Positions and sizes: a thousand kilometres."""
NUMBER = 1e12
"""Other numbers, such as velocities and variances; their squares and sums do not overflow."""
INTEGER = 2**63 - 1
NAME_CHARACTERS = 256
"""Names of joints, shape parameters and cameras."""
LIST_ENTRIES = 10_000
"""Points, shape parameters etc. of a subject: a hand has 21 joints, a face about a hundred points."""
TRIANGLES = 1_000_000
"""Triangles of a subject's mesh."""
CAMERAS = 1000
"""Cameras of a rig."""

# Folders

SEARCH_ENTRIES = 1_000_000
"""Directory entries matched by batch patterns, or in one image folder: nine hours at 30 Hz."""

# Lines of text

LINE_BYTES = MIB
"""Line of a reference CSV file; a row of a thousand columns has about 20 kB."""
COLUMNS = 10_000
"""Columns of a reference CSV file; fields of a JSON schema."""
KEY_PARTS = 32
"""Parts of a dotted TOML key such as ``a.b.c``; levels of a JSON schema."""
