"""Files: arrays as ``.npz``, everything else as JSON, written atomically and never pickled; and folders of results.

What is read may hold anything, so its size, memory and time are bounded. A folder of results is new, empty, or says in
a small file that it is ours and for what; see `output_folder`.
"""

from lieednn_sim.io.reading import (
    LARGEST_FILE,
    LARGEST_TEXT,
    Archive,
    is_file,
    load_arrays,
    load_description,
    load_json,
    opened,
    parse_object,
    parse_yaml,
    read_array,
    take,
)
from lieednn_sim.io.writing import (
    MARK,
    atomic_path,
    atomic_paths,
    atomic_text,
    check_outputs,
    fingerprint,
    locked,
    make_directory,
    output_folder,
    save_arrays,
    save_json,
    short,
)

__all__ = [
    "LARGEST_FILE",
    "LARGEST_TEXT",
    "MARK",
    "Archive",
    "atomic_path",
    "atomic_paths",
    "atomic_text",
    "check_outputs",
    "fingerprint",
    "is_file",
    "load_arrays",
    "load_description",
    "load_json",
    "locked",
    "make_directory",
    "opened",
    "output_folder",
    "parse_object",
    "parse_yaml",
    "read_array",
    "save_arrays",
    "save_json",
    "short",
    "take",
]
