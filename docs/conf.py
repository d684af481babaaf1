"""The site: the pages of docs/, the notebooks with their stored outputs, and the references.

That of Python comes from docstrings, that of C++ from the public headers by Doxygen's XML.

The source folder is the repository, so that links between pages and notebooks are those of the Markdown.
"""

from __future__ import annotations

import ast
import base64
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element as Node

from docutils import nodes
from docutils.nodes import Element
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

import burrlab

DOCS = Path(__file__).parent
ROOT = DOCS.parent

project = "burrlab"
author = "the burrlab authors"
copyright = author
version = release = burrlab.__version__
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
]
root_doc = "docs/index"
include_patterns = [
    *("*.md", "docs/*.md", "docs/reference/*", "notebooks/*.ipynb", "tests/golden/psyphy/README.md")
]
exclude_patterns = ["build", ".*"]  # a prefix of Wine there links to the whole disk
nitpicky = True
# a parameter in backticks, and what is made for the user but has no public name
nitpick_ignore_regex = [
    ("py:obj", r"\w+|.*\.(BoneRecipe|Calibration|FitRecord|bootstrap|rising|slope_error)"),
    ("cpp:identifier", r"u?int\d+_t|size_t|Eigen.*|Vec3::.*|ErosionSteps|AnatomyWatch"),
]
default_role = "autolink"  # a name in backticks is a link if burrlab has it
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath"]
html_math_renderer = "mathml"  # the browser sets equations itself, also without a network
nb_execution_mode = "off"  # `make test` executes the notebooks; the site shows what they stored
autosummary_generate = False
autodoc_default_options = {"members": True, "inherited-members": "object, tuple"}
autodoc_typehints = "none"  # types stand in the docstrings
numpydoc_show_class_members = False
html_theme = "furo"
html_copy_source = False
html_show_sourcelink = False
html_title = f"burrlab {release}"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
copybutton_exclude = ".linenos, .gp, .go"

# Sections of the index; they are no part of the Markdown. Other pages of docs/ explain.
SECTIONS = {
    "Tutorials": ["Install and first steps </README>"]
    + sorted(f"/notebooks/{path.stem}" for path in ROOT.glob("notebooks/*.ipynb")),
    "From C++": ["cpp", "simulator", "cpp_reference"],
    "How to": [
        *("fit", "descent", "cluster", "volumes", "tissues", "phantom", "anatomy", "session", "devices"),
        *("trace", "network", "view", "web", "effects", "experiment"),
    ],
    "Reference": ["reference", "gallery", "glossary", "experiment_files"],
    "Explanation": ["paper", "model", "beyond_the_paper", "psychophysics", "simulated_subject", "stability"],
    "Inside": ["measured", "inference", "tick", "hierarchy", "trace_format", "wire", "architecture"],
}
SECTIONS["Project"] = sorted(f"/{path.stem}" for path in ROOT.glob("*.md") if path.stem != "README")
SECTIONS["Project"] += ["releasing", "/tests/golden/psyphy/README"]
PACKAGES = ["", "volume", "anatomy", "effects", "view", "psychophysics"]
PAGES: dict[int, str] = {}  # the public objects, and where each is described
MAKER = re.compile(r"[Mm]ade by `(?:\w+\.)*(\w+)`")  # what a result's docstring says of itself
MENUS: dict[tuple, str] = {}  # of pages that stand in none, by folder
HEADERS = ROOT / "cpp/include"
HEADER_PAGES: dict[str, str] = {}  # of C++, and the first sentence of each
NO_DOXYGEN = "The C++ reference is left out, as Doxygen is not installed (apt-get install doxygen)."
DOXYGEN = f"""
INPUT = .
FILE_PATTERNS = *.hpp
RECURSIVE = YES
OUTPUT_DIRECTORY = {ROOT / "build/doxygen"}
GENERATE_HTML = NO
GENERATE_LATEX = NO
GENERATE_XML = YES
XML_PROGRAMLISTING = NO
QUIET = YES
WARN_IF_UNDOCUMENTED = NO
WARN_AS_ERROR = YES
MACRO_EXPANSION = YES
EXPAND_ONLY_PREDEF = YES
PREDEFINED = BURRLAB_API=
"""


def heading(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n\n"


def without_types(signature: str) -> str:
    """A signature of pybind11 without self and its types, which the docstring gives in words."""
    signature = re.sub(r"array\((.*?)\)", r"\1", signature.partition(" -> ")[0])
    arguments = ast.parse(f"def f{re.sub('<.*?>', '...', signature)}: ...").body[0].args
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        argument.annotation = None
    arguments.args = [argument for argument in arguments.args if argument.arg != "self"]
    return f"({ast.unparse(arguments)})"


def page_texts() -> dict[str, str]:
    """The pages of docs/ and the notebooks, the latter as their code."""
    pages = sorted(
        path for path in DOCS.glob("*.md") if path.stem not in ("index", "architecture", "glossary")
    )
    texts = {f"/docs/{path.stem}": path.read_text(encoding="utf-8") for path in pages}
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        texts[f"/notebooks/{path.stem}"] = "\n".join(code)
    return texts


def see_also(path: str, found: object, texts: dict[str, str]) -> str:
    """Links to the pages that call a name, or what makes it, or have it in backticks, else to its package's page."""
    _, *packages, name = path.split(".")
    if inspect.isclass(found) and (maker := MAKER.search(found.__doc__ or "")):
        name = rf"(?:{name}|{maker[1]})"
    way = "".join(rf"(?:{package}\.)?" for package in ("burrlab", *packages))
    called = re.compile(rf"(?<![\w.]){way}{name}\(|`{way}{name}(?:\(.*?\))?`")
    pages = [page for page, text in texts.items() if called.search(text)]
    home = "/docs/" + {"": "model", "volume": "volumes"}.get("".join(packages), "".join(packages))
    listing = "".join(f"   * :doc:`{page}`\n" for page in pages or [home])
    return f"\n.. seealso::\n\n{listing}"


def entry(path: str, found: object, texts: dict[str, str]) -> str:
    """The page of one name."""
    kind = "class" if inspect.isclass(found) else "module" if inspect.ismodule(found) else "function"
    kind = kind if callable(found) or kind == "module" else "data"
    made = (found.__init__.__doc__ or "").partition("\n")[0] if kind == "class" else ""
    signature = without_types(made.removeprefix("__init__")) if made.startswith("__init__(self: ") else ""
    options = "   :no-value:\n" if kind == "data" else ""
    back = path.rpartition(".")[0]
    head = f":orphan:\n\n:doc:`{back} <{back}>`\n\n{heading(path, '=')}"
    return f"{head}.. auto{kind}:: {path}{signature}\n{options}{see_also(path, found, texts)}"


def write_reference(folder: Path) -> None:
    """A page for each package, and for each of its public names; a name of two packages has one page."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    texts = page_texts()
    for name in PACKAGES:
        package = importlib.import_module(f"burrlab.{name}".rstrip("."))
        groups: dict[str, list[str]] = {}
        names = sorted(set(dir(package)) - {"__version__"})
        twins = {public.lower() for public in names if public != public.lower()}
        for public in names:
            found = getattr(package, public)
            path = PAGES.setdefault(id(found), f"{package.__name__}.{public}")
            if path == f"{package.__name__}.{public}":
                file = f"{path}_" if public in twins else path  # Fit and fit, on any file system
                (folder / f"{file}.rst").write_text(entry(path, found, texts), encoding="utf-8")
            home = getattr(found, "__module__", None) or package.__name__
            home = ".".join(home.split(".")[: 3 if name else 2])
            groups.setdefault(home, []).append(public if path.endswith(f"{name}.{public}") else path)
        text = (
            heading(package.__name__, "=") + f"{package.__doc__}\n\n.. currentmodule:: {package.__name__}\n\n"
        )
        for home, paths in groups.items():
            title = re.split(r"[:;]|\.(?=\s|$)", inspect.getdoc(importlib.import_module(home)))[0]
            text += heading(title, "-") if len(groups) > 1 else ""
            text += (
                ".. autosummary::\n   :nosignatures:\n\n" + textwrap.indent("\n".join(paths), "   ") + "\n\n"
            )
        (folder / f"{package.__name__}.rst").write_text(text, encoding="utf-8")


def escape(text: str | None) -> str:
    return re.sub(r"([\\*|]|_(?!\w))", r"\\\1", text or "")


def comment_of(node: Node) -> str:
    """The comment of a declaration, and those of the names of an enumeration."""
    text = ""
    for para in (*node.findall("briefdescription/para"), *node.findall("detaileddescription/para")):
        for part in para.iter():
            text += f"``{part.text}``" if part.tag == "computeroutput" else escape(part.text)
            text += escape(part.tail) if part is not para else ""
        text += "\n\n"
    for name in node.findall("enumvalue"):
        text += f".. cpp:enumerator:: {name.findtext('name')}\n\n" + textwrap.indent(comment_of(name), "   ")
    return text


def declaration(node: Node, name: str) -> str:
    """A declaration of C++ as Sphinx takes it."""
    kind, text = node.get("kind"), name
    type_name, initializer = (
        "".join(text for part in node.findall(tag) for text in part.itertext())
        for tag in ("type", "initializer")
    )
    if bases := node.findall("basecompoundref"):
        text += " : " + ", ".join("public " + base.text.removeprefix("burrlab::") for base in bases)
    elif kind == "typedef":
        kind, text = "type", f"{name} = {type_name}"
    elif kind == "enum":
        kind = "enum-class" if node.get("strong") == "yes" else "enum"
    elif kind in ("function", "variable"):
        words = [word for word in ("static", "explicit") if node.get(word) == "yes"]
        words += ["virtual"] if node.get("virt", "non-virtual") != "non-virtual" else []
        text = " ".join((*words, type_name.removeprefix("enum burrlab::"), name)) + node.findtext(
            "argsstring", ""
        )
        if kind == "variable":
            kind, text = "member", f"{text} {initializer}"
    if types := [" ".join(part.itertext()).split() for part in node.findall("templateparamlist/param")]:
        text = f"template <{', '.join(' '.join(words[:2]) for words in types)}> {text}"
    return f".. cpp:{kind}:: {' '.join(text.split())}\n\n"


def first_comment(file: Path) -> tuple[str, str]:
    """The title of a header, and its first comment, whose indented lines are an example."""
    text = re.match(r"(//[^\n]*\n)+|/\*.*?\*/", file.read_text(encoding="utf-8"), re.DOTALL)[0]
    text = re.sub(r"^(//|/\*| \*/?) ?| \*/$", "", text, flags=re.MULTILINE)
    lines = [
        line if line.startswith("  ") else "``".join(map(escape, line.split("`")))
        for line in text.splitlines()
    ]
    page = re.sub(r"\n\n(?=  )", "\n\n.. code-block:: cpp\n\n", "\n".join(lines), count=1)
    return " ".join(re.split(r"\.\s+(?=[A-Z]|$)", text.partition("\n\n")[0])[0].rstrip(".:").split()), page


def write_headers(folder: Path) -> None:
    """A page for each public header: its first comment, and its public declarations in their order."""
    shutil.rmtree(ROOT / "build/doxygen", ignore_errors=True)
    (ROOT / "build").mkdir(exist_ok=True)
    subprocess.run(["doxygen", "-"], input=DOXYGEN, text=True, cwd=HEADERS, check=True)
    entries: dict[tuple[str, int, int], str] = {}  # by place in the headers
    trees = (ElementTree.parse(file) for file in (ROOT / "build/doxygen/xml").glob("*.xml"))
    compounds = [node for tree in trees for node in tree.iter("compounddef") if node.get("prot") != "private"]
    for node in (node for compound in compounds for node in (compound, *compound.iter("memberdef"))):
        name = node.findtext("qualifiedname") or node.findtext("compoundname")  # neither: a macro
        if node.get("prot") != "public" or not name:
            continue
        scopes, text, place = name.split("::")[1:], comment_of(node), node.find("location").attrib
        if text:
            entries[place["file"], int(place["line"]), int(place["column"])] = textwrap.indent(
                declaration(node, scopes[-1]) + textwrap.indent(text, "   "), "   " * (len(scopes) - 1)
            )
        elif not re.match("~|operator", scopes[-1]) and not re.search(
            r"&[&)]", node.findtext("argsstring", "")
        ):
            logging.getLogger(__name__).warning("%s has no comment in its header", name)
    for file in sorted(HEADERS.rglob("*.h*"), key=lambda file: (file.stem != "burrlab", file)):
        path = file.relative_to(HEADERS).as_posix()
        HEADER_PAGES[path], text = first_comment(file)
        if path == "burrlab.h":  # who calls it from C or binds it reads it as it is
            text += f"\n\n.. literalinclude:: /{file.relative_to(ROOT).as_posix()}\n   :language: c\n"
            text += "   :start-at: #define BURRLAB_ABI_VERSION\n   :end-before: #ifdef __cplusplus\n"
        text += "\n\n.. cpp:namespace:: burrlab\n\n"
        text += "".join(entries[place] for place in sorted(entries) if place[0] == path)
        (folder / f"{path.replace('/', '.')}.rst").write_text(heading(path, "=") + text, encoding="utf-8")


def short_signature(
    app: Sphinx, what: str, name: str, found: object, options: object, text: str, returns: str
):
    """No types, and no signature of what users do not make themselves."""
    if inspect.isclass(found) and MAKER.search(found.__doc__ or ""):
        return "", None
    typed = text is not None and ("typing." in text or "burrlab._core" in text or "self: object" in text)
    return (without_types(text), None) if typed else None


def escape_bars(app: Sphinx, what: str, name: str, found: object, options: object, lines: list[str]) -> None:
    """|x| is a size here, not a substitution."""
    lines[:] = [line if ">>>" in line or "`" in line else line.replace("|", r"\|") for line in lines]


def find_public(app: Sphinx, env: object, node: Element, content: Element) -> Element | None:
    """A link for a class or function that a docstring names by its module, or without one."""
    domain = env.domains.python_domain
    names = re.findall(r"\w+", node.get("reftarget", ""))
    for start in range(len(names)):
        end = "." + ".".join(names[start:])
        whole = start < len(names) - 1
        found = {
            (place.docname, place.node_id)
            for path, place in domain.objects.items()
            if path.endswith(end) and (whole or place.objtype in ("class", "function"))
        }
        if len(found) == 1:
            (place,) = found
            return make_refnode(app.builder, node.get("refdoc", root_doc), *place, content)
    return None


def figures(notebook: Path) -> str:
    """Thumbnails of the pictures that a notebook stored, each a link to it, with the text that its cell's metadata has."""
    text, above = "", []
    for number, cell in enumerate(json.loads(notebook.read_text(encoding="utf-8"))["cells"]):
        code = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            above += re.findall("^#+ (.*)", code, re.MULTILINE)
        for place, output in enumerate(cell.get("outputs", [])):
            if picture := output.get("data", {}).get("image/png"):
                file = ROOT / f"build/gallery/{notebook.stem}-{number}-{place}.png"
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(base64.b64decode(picture))
                seen = cell["metadata"]["mystnb"]["image"]["alt"]
                text += f":::{{grid-item-card}} {above[-1]}\n:img-top: /build/gallery/{file.name}\n:img-alt: {seen}\n"
                text += f":link: /notebooks/{notebook.stem}\n:link-type: doc\n:::\n"
    return f"\n\n## [{above[0]}](../notebooks/{notebook.name})\n\n::::{{grid}} 1 2 3 3\n{text}::::\n"


def complete_outputs(app: Sphinx, tree: Element) -> None:
    """Leads links in notebooks' outputs to pages of the site."""
    for link in tree.findall(nodes.reference):
        if (uri := link.get("refuri", "")).startswith("../"):
            link["refuri"] = re.sub(r"\.(md|ipynb)(?=#|$)", ".html", uri)


def complete(app: Sphinx, page: str, source: list[str]) -> None:
    """Adds the sections to the index, the packages to the reference, and the figures to the gallery."""
    toctree = "\n\n```{{toctree}}\n:hidden:\n:caption: {}\n\n{}\n```\n"
    if page == root_doc:
        source[0] += "".join(toctree.format(title, "\n".join(pages)) for title, pages in SECTIONS.items())
    if page == "docs/reference":
        names = "\n".join(f"reference/burrlab.{name}".rstrip(".") for name in PACKAGES)
        source[0] += f"\n\n```{{toctree}}\n\n{names}\n```\n"
    if page == "docs/cpp_reference":
        rows = {path: f"reference/{path.replace('/', '.')}" for path in HEADER_PAGES}
        names = [f"{path.removeprefix('burrlab/')} <{page}>" for path, page in rows.items()]
        source[0] += "\n| header | |\n|---|---|\n" if rows else f"\n{NO_DOXYGEN}\n"
        source[0] += "".join(
            f"| [{path}]({rows[path]}.rst) | {title} |\n" for path, title in HEADER_PAGES.items()
        )
        source[0] += "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n" if rows else ""
    if page == "docs/gallery":
        source[0] += "".join(figures(ROOT / f".{page}.ipynb") for page in SECTIONS["Tutorials"][1:])


def share_menu(app: Sphinx, page: str, template: str, context: dict, tree: Element | None) -> None:
    """Makes one menu for all pages of a folder that stand in no menu: it has the same links and marks no page."""
    if "orphan" not in app.env.metadata.get(page, {}):
        return
    make, folder = context["toctree"], page.rpartition("/")[0]

    def menu(**options: object) -> str:
        key = folder, *sorted(options.items())
        if key not in MENUS:
            MENUS[key] = make(**options)
        return MENUS[key]

    context["toctree"] = menu


def set_formula(translator: object, node: Element) -> None:
    """Writes an equation as MathML: within a line, or on lines of its own."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    translator.body.append(convert(node.astext(), display=display))
    raise nodes.SkipNode


def check_names(app: Sphinx, env: object) -> None:
    """Every public name is described."""
    domain = env.domains.python_domain
    if missing := set(PAGES.values()) - set(domain.objects) - set(domain.modules):
        logging.getLogger(__name__).warning("the reference lacks %s", sorted(missing))


def lead_in(app: Sphinx, exception: Exception | None) -> None:
    """The folder's own index.html leads to the index."""
    (app.outdir / "index.html").write_text(f'<meta http-equiv="refresh" content="0; url={root_doc}.html">\n')


def setup(app: Sphinx) -> None:
    app.add_html_math_renderer("mathml", (set_formula, None), (set_formula, None))
    write_reference(DOCS / "reference")
    if shutil.which("doxygen"):
        write_headers(DOCS / "reference")
    else:
        print(NO_DOXYGEN, file=sys.stderr)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("missing-reference", find_public)
    app.connect("env-check-consistency", check_names)
    app.connect("build-finished", lead_in)
    app.connect("source-read", complete)
    app.connect("doctree-read", complete_outputs)
    app.connect("html-page-context", share_menu, priority=400)  # before the theme's
