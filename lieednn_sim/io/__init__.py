"""Files: arrays as ``.npz``, everything else as JSON, written atomically and never pickled; and folders of results."""

from lieednn_sim.io.reading import Archive as Archive
from lieednn_sim.io.reading import is_file as is_file
from lieednn_sim.io.reading import load_arrays as load_arrays
from lieednn_sim.io.reading import load_description as load_description
from lieednn_sim.io.reading import load_json as load_json
from lieednn_sim.io.reading import opened as opened
from lieednn_sim.io.reading import read_array as read_array
from lieednn_sim.io.reading import take as take
from lieednn_sim.io.writing import UNFINISHED as UNFINISHED
from lieednn_sim.io.writing import atomic_path as atomic_path
from lieednn_sim.io.writing import atomic_paths as atomic_paths
from lieednn_sim.io.writing import check_outputs as check_outputs
from lieednn_sim.io.writing import fingerprint as fingerprint
from lieednn_sim.io.writing import locked as locked
from lieednn_sim.io.writing import make_directory as make_directory
from lieednn_sim.io.writing import output_folder as output_folder
from lieednn_sim.io.writing import save_arrays as save_arrays
from lieednn_sim.io.writing import save_csv as save_csv
from lieednn_sim.io.writing import save_json as save_json
from lieednn_sim.io.writing import save_text as save_text
from lieednn_sim.io.writing import short as short
