"""What `make docs` adds to the pages of this folder: every key of a run, and every public name of the package.

The keys' texts are the comments beside the fields of the configuration models. MkDocs calls the functions ``on_...``.
"""

import inspect
import json
import os
import re
from collections.abc import Iterator
from functools import cache, reduce
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

import moteslam
from moteslam.robot.platforms import bundled_platform, bundled_platforms
from moteslam.robot.values import LARGEST, SMALLEST
from moteslam.sim.scenario import bundled_scenarios, load_scenario
from moteslam.slam.backend.protocol import BACKENDS
from moteslam.slam.config import METHODS, ParticleFilterConfig, SlamConfig

DOCS = Path(__file__).parent
BUNDLED = ("tsdf", "paper")
"""The methods whose keys are listed, that of the preset ``default`` first."""

FIGURES = (
    *("length", "width", "top_speed", "wheels.metres_per_count", "wheels.track", "wheels.effective_track"),
    *("body.mass", "encoders.rate", "imu.rate"),
    *(f"lidar.{key}" for key in ("beams", "angle_min", "angle_increment", "rate", "time_increment", "range_min")),
    *("lidar.range_max", "lidar.x", "lidar.z"),
    *(f"noise.lidar.{key}" for key in ("range_noise", "range_noise_per_metre", "resolution", "dropout")),
    *(f"noise.encoders.{key}" for key in ("scale_error", "radius_error", "track_error", "slip")),
    *(f"noise.imu.{key}" for key in ("gyro_noise", "gyro_bias", "gyro_bias_walk", "gyro_scale_error")),
)
"""Of a robot, in the table of all; metres, seconds, radians, kilograms, hertz."""

HEAD = """# Configuration of a SLAM run

Each key has its default, the interval of its values, and what it is ([how to set keys](../guide/configure.md)); `paper`
is the default of that method where it differs. A run takes the keys of its own method alone and refuses all others.
"""


def configuration() -> str:
    """Every key of a SLAM run: those of all methods, of the back end, of each method."""
    defaults = {name: METHODS[name].config.model_validate({}) for name in BUNDLED}
    default, paper = defaults.values()
    graph = BACKENDS["graph"].config.model_validate({})
    shared = {**SlamConfig.model_fields, **ParticleFilterConfig.model_fields}.keys() - {"backend"}
    lines = [
        HEAD,
        "## Of both methods",
        "",
        *_block(default, "", [k for k in type(default).model_fields if k in shared], paper),
    ]
    for name, config in defaults.items():
        lines += [f"## Of the method `{name}`", ""]
        lines += _block(config, "", [k for k in type(config).model_fields if k not in shared | {"backend"}])
    lines += ["## Of the method `known_map`", "", "The keys of `tsdf`, some with other defaults, and:", ""]
    known = METHODS["known_map"].config.model_validate({})
    lines += _block(known, "", [k for k in type(known).model_fields if k not in type(default).model_fields])
    lines += ["## Of the back end", ""]
    lines += [
        f"`backend.method` is `{graph.method}` with `tsdf`, `{paper.backend.method}` with `paper`. Of `graph`:",
        "",
    ]
    same = [name for name, value in graph if value == getattr(default, name, None)]
    lines += _block(graph, "backend", [key for key in type(graph).model_fields if key not in {*same, "method"}])
    lines += [
        f"{', '.join(f'`[backend.{name}]`' for name in same)}: the keys and defaults of the same sections of `tsdf`."
    ]
    return "\n".join(lines) + "\n"


def _block(config: BaseModel, section: str, keys: list[str], other: BaseModel | None = None) -> list[str]:
    """A TOML block a section, first of the keys that lie in none."""
    values = {key: getattr(config, key) for key in keys}
    lines = [_line(config, key, other) for key, value in values.items() if not isinstance(value, BaseModel)]
    if lines:
        lines = ["```toml", *([f"[{section}]"] if section else []), *lines, "```", ""]
    for key, value in values.items():
        if isinstance(value, BaseModel):
            inner = list(type(value).model_fields)
            lines += _block(value, f"{section}.{key}".lstrip("."), inner, getattr(other, key, None))
    return lines


def _line(config: BaseModel, key: str, other: BaseModel | None) -> str:
    """``key = default  # interval  what it is``, with the default of the other method where it differs."""
    value, field = getattr(config, key), type(config).model_fields[key]
    comment = [_allowed(field), _short(_meanings(type(config))[key])]
    if other is not None and getattr(other, key) != value:
        comment.insert(1, f"(`paper`: {_shown(getattr(other, key))})")
    return f"{key} = {_shown(value)}  # {'  '.join(filter(None, comment))}"


def _short(text: str) -> str:
    """A text up to its first full stop or colon, and its unit where that comes later."""
    text = " ".join(text.replace("``", "`").split())
    short = re.split(r"(?<!\.)[.:](?: |$)", text)[0]
    unit = re.search(r"\[[^\]]+\]", text)
    return short if unit is None or unit[0] in short else f"{short} {unit[0]}"


def _fields(model: type) -> Iterator[tuple[str, list[str], str]]:
    """Of each field in a model's source the name, the comments in the lines above it, and the one beside it."""
    above: list[str] = []
    for line in inspect.getsource(model).splitlines():
        if comment := re.match(r"    # (.*)", line):
            above.append(comment[1])
            continue
        if field := re.match(r"    (\w+): [^#]*(?:# (.*))?$", line):
            yield field[1], above, field[2] or ""
        above = []


@cache
def _meanings(model: type) -> dict[str, str]:
    """What the comments say of each field of a model, and of those of its bases."""
    bases = [base for base in reversed(model.__mro__) if base.__module__.startswith("moteslam.")]
    fields = (field for base in bases for field in _fields(base))
    return {name: text for name, above, beside in fields if (text := beside or " ".join(above))}


def _allowed(field: FieldInfo) -> str:
    """The words that a key takes, or the interval of its numbers; nothing where any number will do."""
    kind = field.annotation
    if get_origin(kind) is Literal:
        words = get_args(kind)
        return " | ".join(json.dumps(word) for word in words) if len(words) > 1 else ""
    if kind not in (int, float):
        return ""
    bounds = dict(_bounds(field))
    if bounds.get("ge") == SMALLEST:
        bounds["gt"] = 0
    low, high = bounds.get("gt", bounds.get("ge")), bounds.get("lt", bounds.get("le"))
    if low is None and high is None:
        return ""
    left = "(-inf" if low is None else f"{'(' if 'gt' in bounds else '['}{low:g}"
    right = "inf)" if high is None else f"{high:g}{')' if 'lt' in bounds else ']'}"
    return f"{left}, {right}"


def _bounds(field: FieldInfo) -> Iterator[tuple[str, float]]:
    for part in field.metadata:
        for name in ("ge", "gt", "le", "lt"):
            bound = getattr(part, name, None)
            if bound is not None and abs(bound) != LARGEST:  # every number's own
                yield name, bound


def _shown(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, float):
        return f"{value:.6g}" if value != round(value) or value >= 1e6 else f"{value:.1f}"
    return json.dumps(value)


def robots() -> str:
    """A table of the figures of all bundled robots, a `-` where one has none."""
    platforms = [bundled_platform(name) for name in bundled_platforms()]
    lines = [f"| | {' | '.join(f'`{platform.name}`' for platform in platforms)} |", "|---" * (1 + len(platforms)) + "|"]
    for key in FIGURES:
        figures = [reduce(lambda part, name: getattr(part, name, None), key.split("."), each) for each in platforms]
        lines.append(f"| `{key}` | {' | '.join('-' if each is None else f'{each:.4g}' for each in figures)} |")
    return "\n".join(lines)


def noise() -> str:
    """The keys of the noise, with the values of `ucsd`."""
    whole = bundled_platform("ucsd").noise
    sections = {"noise": whole, **{f"noise.{name}": part for name, part in whole if isinstance(part, BaseModel)}}
    return _commented({**sections, "noise.lidar.clock": whole.lidar.clock})


def robot() -> str:
    """The keys of a robot but for its noise, with the values of `ucsd`."""
    whole = bundled_platform("ucsd")
    parts = {
        name: part
        for name, part in whole
        if isinstance(part, BaseModel) and part not in (whole.noise, whole.as_recorded)
    }
    assert whole.camera is not None
    return _commented({"": whole, **parts, "camera.sensor": whole.camera.sensor})


def _commented(sections: dict[str, Any]) -> str:
    """Tables of a TOML file, and what the comments of their models say of each key."""
    lines = []
    for name, part in sections.items():
        lines += ["", f"[{name}]"] if name else [""]
        for key, above, beside in _fields(type(part)):
            value = getattr(part, key, None)
            lines += [f"# {comment}" for comment in above]
            if key in type(part).model_fields and not isinstance(value, BaseModel):
                shown = "false" if value is None else _shown(value)
                lines.append(f"{key} = {shown}" + f"  # {beside}" * bool(beside))
    return "\n".join(("```toml", *lines[1:], "```"))


def scenarios() -> str:
    """The bundled scenarios, and why each is hard."""
    loaded = [load_scenario(name) for name in bundled_scenarios()]
    rows = (f"| `{each.name}` | {each.description} | {each.why} |" for each in loaded)
    return "\n".join(("| name | what it is | why it is hard |", "|---|---|---|", *rows))


TABLES = {
    "figures of the robots": robots,
    "keys of a robot": robot,
    "keys of the noise": noise,
    "bundled scenarios": scenarios,
}
"""What stands in the place of a comment of that text."""


def names() -> str:
    """Every public name, by the module that defines it; mkdocstrings puts the docstrings in."""
    lines = ["# The package", "", "Each name is one of `moteslam`: `from moteslam import OnlineSlam`.", ""]
    for module, defined in moteslam.PUBLIC.items():
        lines += [f"## {module.removeprefix('moteslam.')}", "", *(f"::: {module}.{name}" for name in defined), ""]
    return "\n".join(lines)


def on_files(files: Any, config: Any) -> Any:
    """Add the two generated pages."""
    from mkdocs.structure.files import File

    for name, page in (("configuration", configuration()), ("package", names())):
        files.append(File.generated(config, f"reference/{name}.md", content=page))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Links to files outside this folder lead to them in the checkout, as seen from the built page."""

    def outside(link: re.Match[str]) -> str:
        target, anchor = (DOCS / page.file.src_uri).parent / link[2], link[3] or ""
        if target.resolve().is_relative_to(DOCS.resolve()):
            return link[0]
        seen = os.path.relpath(target.resolve(), Path(page.file.abs_dest_path).resolve().parent)
        return f'<a href="{seen}{anchor}">{link[1]}</a>'

    for name, made in TABLES.items():
        if (marker := f"<!-- {name} -->") in markdown:
            markdown = markdown.replace(marker, made())
    return re.sub(r"(?<!!)\[([^\]]*)\]\((\.\./[^)#\s]*)(#[^)\s]*)?\)", outside, markdown)
