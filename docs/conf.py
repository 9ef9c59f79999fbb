# SPDX-License-Identifier: BSD-3-Clause
"""How the documentation is built: `python -m sphinx -W --keep-going -b html docs docs/_build/html`.

Nothing here needs a network, neither while building nor while reading.
"""

import atexit
import os
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
# Cells call the program as a reader does; it lies beside this Python, whether or not its environment is active.
os.environ["PATH"] = str(Path(sys.executable).parent) + os.pathsep + os.environ["PATH"]
os.environ.setdefault("OMP_NUM_THREADS", "1")
# What is run in every page's kernel before its first cell; in a folder of its own, as IPython also writes there.
os.environ["IPYTHONDIR"] = tempfile.mkdtemp(prefix="faultrecon-docs-")
startup = Path(os.environ["IPYTHONDIR"], "profile_default", "startup")
startup.mkdir(parents=True)
shutil.copy(HERE / "_ext" / "kernel_startup.py", startup / "00-startup.py")
atexit.register(shutil.rmtree, os.environ["IPYTHONDIR"], ignore_errors=True)

import faultrecon  # noqa: E402 - after the paths are set

project = "faultrecon"
author = "The faultrecon authors"
copyright = author
version = release = faultrecon.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinxcontrib.bibtex", "faultrecon_docs"]
exclude_patterns = ["_build", "papers/notes", "benchmarks"]
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext"}

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_block", "attrs_inline"]
myst_heading_anchors = 3
smartquotes_action = "qe"  # quotes and ellipses; two hyphens are an option of the command line

# Every page runs anew, so that no page shows what an older version printed; a cell that fails, fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 120
nb_merge_streams = True
nb_ipywidgets_js = {}

html_math_renderer = "svg"
math_numfig = False

autodoc_member_order = "bysource"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88

bibtex_bibfiles = ["references.bib", "papers/papers.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

html_theme = "furo"
html_title = f"faultrecon {release}"
html_static_path = ["_static"]
html_css_files = ["faultrecon.css"]
html_copy_source = False
html_show_sphinx = False
