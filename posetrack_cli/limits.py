"""How much of a file is taken before it is refused: bounds that no real recording meets, all in one place.

A recording is data from strangers. A few kilobytes can claim to be gigabytes, and be believed by a decoder;
so whatever allocates or loops by what a file says asks one of these first. SECURITY.md tells why.
"""

from __future__ import annotations

MIB = 1 << 20

# Compressed data

CHUNK_BYTES = 128 * MIB
"""Of one MCAP chunk when decompressed. Writers end chunks at 1 to 64 MiB, or after one larger message."""
RECORD_BYTES = 1024 * MIB
"""Of a record of an MCAP file as it is stored, such as an attachment: it is read whole."""
EXPANSION_FLOOR_BYTES = 1024 * MIB
EXPANSION = 256
"""All chunks of an MCAP file decompress to at most the floor or so many times the file, whichever is more.

Blank depth images compress better than that, but not a whole recording of them.
"""
PENDING_BYTES = 512 * MIB
"""Of messages that wait for their turn because chunks overlap in time."""
BYTES_PER_RECORD = 2
SPARE_RECORDS = 16
"""A chunk holds at most one record for so many compressed bytes, and the spare ones.

Messages without any content at 1 kHz of a simulated clock, which differ in nothing but their stamps, take 2.8
bytes each in zstd's level 19; with a real clock's stamps 5 and more.
"""

BAG_HEAD_BYTES = MIB
"""Of the head of a record of a ROS 1 bag: a few names and numbers."""
DATABASE_STEPS_PER_BYTE, SPARE_DATABASE_STEPS = 4, 1_000_000
"""What SQLite may do for one query of a ROS 2 database, for each byte of it and to spare: a row takes ten
steps and, as it is stored, 30 bytes at least."""
DEFINITION_BYTES = 64 * MIB
CHANNEL_BYTES = 4 * MIB
"""Of all different schemas, and of all different channels, within the chunks of an MCAP file.

A thousand topics of ROS 2 take 1 MiB as channels with their quality of service, and 20 MiB as schemas.
"""
CHANNELS = 65_535
"""Of an MCAP file that is written: their numbers have 16 bits."""
SUMMARY_BYTES = 256 * MIB
"""Of the index of an MCAP file, which is read whole: 2 million chunks."""
MESSAGES = 1 << 40
"""That an index may tell of: at 1 kHz the messages of 35 years."""

# Pixels

IMAGE_PIXELS = 1 << 25
"""Of one image: 8K video has 33.2 million pixels."""
JPEG_SCANS = 30
"""Of a progressive JPEG, each of which goes over the whole image: encoders write about ten."""
TILE_PIXELS = 1 << 22
"""Of one tile of a TIFF, which is decoded whole for the smallest image: writers use 128 to 1024 squared."""

TIFF_PAGES = 1 << 20
"""Of one TIFF, each of which is a frame: ten hours of 30 frames a second."""

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
KEYPOINT_BYTES = 256 * MIB
"""Of keypoints from elsewhere as CSV or JSON lines, which are read line by line: an hour takes 50 MB."""
KEYPOINT_JSON_BYTES = 32 * MIB
"""Of those in one JSON value, which takes 25 times its size in memory at worst: a quarter of an hour."""
KEYPOINT_SETS = 250_000
"""Hands, and frames, in such a file: two hours of 30 frames a second."""

# Meshes: a hand's skin has some thousand points and 25 joints, a whole character ten times as many

MESH_NODES = 10_000
MESH_JOINTS = 512
MESH_POINTS = 250_000
"""Of all parts of a skin; scans of a hand have a tenth of it."""
MESH_TRIANGLES = 500_000
MESH_WEIGHTS = 1 << 24
"""Points times joints: each point has a weight for each joint."""
MESH_VALENCE = 2_000
"""Triangles at one point, also in the middle of a hole that was closed: what simplifies squares them."""
MESH_REACH = 1e6
"""Of coordinates, lengths and scales, in a file's units: a kilometre in millimetres."""

# Arrays

MODEL_BYTES = 256 * MIB
"""Of a file of a face model, or of what was learned of a head: templates of a hundred people take less."""
MODEL_TRIAL_S = 60
MODEL_TRIAL_BYTES = 2048 * MIB
"""Time, and address space, in which a face detector's model is tried: YuNet takes a second and 0.9 GiB."""
FACE_PARAMETERS = 256
"""Of identity, and of deformation; morphable models have up to 199 and 29."""
FACES = 6
GUESSES = 60
"""Faces of an image whose points are looked for, the largest, and that are considered at all, the surest. A
face takes a tenth of a second, and a damaged network finds thousands."""
NPZ_FLOOR_BYTES = 256 * MIB
NPZ_EXPANSION = 16
"""All arrays of an npz file take at most the floor or so many times the file; ours are not compressed."""
PEOPLE = 5_000
"""Whom one camera saw in a recording. A cut may bring a new person, a recording has fewer cuts."""
NPZ_ARRAYS = 100_000
"""In one npz file."""

# Messages that are not images

MESSAGE_BYTES = 1 * MIB
"""Of a calibration, a set of transforms or an estimate: a thousand transforms take 0.15 MiB."""
DEFINITION_CHARACTERS = 1 * MIB
"""Of the definition of one ROS message with all its parts: the longest of ROS have 20,000."""
TRANSFORMS = 20_000
"""Of all messages of a file, as far as they are looked at; and so many bytes of them:"""
TRANSFORM_BYTES = 16 * MIB

# Frames that an export makes up

EXPORT_FRAMES = 10_000
EXPORT_EXPANSION = 16
"""Of a format with a fixed frame rate, whose frames fill the gaps between estimates: at most so many, or so
many times the estimates, whichever is more. Five minutes at 30 Hz, or gaps of 15 s for each second between.
"""

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

# Folders

SEARCH_ENTRIES = 1_000_000
"""Files and folders that the patterns of a batch look at, or that one recording's folder holds: nine hours of
images at 30 frames a second."""

# Lines of text

LINE_BYTES = MIB
"""Of a line of a truth in CSV: a row of a thousand columns has some 20 kB."""
COLUMNS = 10_000
"""Of such a file."""
KEY_PARTS = 32
"""Of a dotted key in TOML, such as ``a.b.c``."""
