"""What the budgets of the source tree count: size, density and fragmentation, from tokens and syntax trees.

python tests/architecture/measures.py           what is counted, beside its budget
python tests/architecture/measures.py --lower   write the budgets that have fallen
"""

from __future__ import annotations

import ast
import io
import math
import re
import sys
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

SRC = Path(__file__).parents[2] / "src" / "ringtrue"
BUDGETS = Path(__file__).with_name("budgets.toml")

SHORT_MODULE = 60  # code lines: below, a module with one importer is a fragment of it
# lines: up to them, a private function that is called once is one of its caller
SHORT_FUNCTION = 6
MOST_PARAMETERS = 6
MOST_POSITIONAL = 5
MOST_FIELDS = 12
MOST_CONSTANTS = 8
TOKEN_STEP = 500  # of the budgets of tokens

LAYOUT = {
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
PRIVATE_WORDS = re.compile(
    r"\b(told|tells|sure|beside|apart|alike|lent|listened|lacking|claims|hardly|desk)\b"
)
READS_TEXT = {"startswith", "endswith", "partition", "rpartition"}
SENTENCE = re.compile(
    r"\b(note|notes|reason|reasons|why|message|messages|sentence)\b|str\("
)


@dataclass(frozen=True)
class Module:
    """A module of the package.

    Attributes
    ----------
    name : str
        With its packages: `ringtrue.core.dofs`.
    path : Path
    text : str
    """

    name: str
    path: Path
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """Its syntax."""
        return ast.parse(self.text)

    @property
    def package(self) -> str:
        """The folder below ringtrue, or the module itself where it stands in none."""
        return self.name.split(".")[1] if "." in self.name else self.name

    @cached_property
    def docstring_lines(self) -> set[int]:
        """Numbers of the lines of docstrings."""
        lines: set[int] = set()
        for node in ast.walk(self.tree):
            if (
                not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
                or not node.body
            ):
                continue
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines.update(
                    range(first.lineno, (first.end_lineno or first.lineno) + 1)
                )
        return lines

    @cached_property
    def tokens(self) -> list[tokenize.TokenInfo]:
        """All but layout, comments and docstrings."""
        every = tokenize.generate_tokens(io.StringIO(self.text).readline)
        skipped = LAYOUT | {tokenize.COMMENT}
        return [
            t
            for t in every
            if t.type not in skipped and t.start[0] not in self.docstring_lines
        ]

    @cached_property
    def code_lines(self) -> set[int]:
        """Numbers of the lines with code."""
        lines: set[int] = set()
        for token in self.tokens:
            lines.update(range(token.start[0], token.end[0] + 1))
        return lines

    @cached_property
    def imports(self) -> set[str]:
        """Names that it imports, modules and what is taken of them; not those for types alone."""
        names: set[str] = set()
        for node in _run(self.tree):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module)
                names.update(f"{node.module}.{alias.name}" for alias in node.names)
        return names


def modules(root: Path = SRC) -> list[Module]:
    """Every module below a folder."""
    found = []
    for path in sorted(root.rglob("*.py")):
        parts = [root.name, *path.relative_to(root).with_suffix("").parts]
        found.append(Module(".".join(parts), path, path.read_text(encoding="utf-8")))
    return found


def measured(every: list[Module]) -> dict[str, dict[str, int]]:
    """All figures: `tokens` by package, and `counts`."""
    tokens: Counter[str] = Counter()
    for module in every:
        tokens[module.package] += len(module.tokens)
    lines = sum(len(m.code_lines) for m in every)
    widths = sorted(
        len(line)
        for m in every
        for number, line in enumerate(m.text.splitlines(), start=1)
        if number in m.code_lines
    )
    by_module = [constants(m) for m in every]
    counts = {
        "files": len(every),
        "tokens": tokens.total(),
        "tokens in ten code lines": round(10 * tokens.total() / max(lines, 1)),
        "width of nine lines in ten": widths[int(0.9 * (len(widths) - 1))]
        if widths
        else 0,
        "short modules with one importer": len(fragments(every)),
        "short private functions called once": sum(len(called_once(m)) for m in every),
        "functions of many parameters": sum(len(many_parameters(m)) for m in every),
        "calls with many positional arguments": sum(
            len(many_positional(m)) for m in every
        ),
        "dataclasses of many fields": sum(len(many_fields(m)) for m in every),
        "numeric constants": sum(by_module),
        "modules of many numeric constants": sum(n > MOST_CONSTANTS for n in by_module),
        "modules in cycles": sum(len(c) for c in cycles(every)),
        "class names defined twice": len(defined_twice(every)),
        "private words": sum(len(PRIVATE_WORDS.findall(m.text)) for m in every),
        "sentences read by code": sum(len(sentences_read(m)) for m in every),
    }
    return {"counts": counts, "tokens": dict(sorted(tokens.items()))}


def fragments(every: list[Module]) -> list[str]:
    """Short modules that one other module imports."""
    names = {m.name: m for m in every}
    importers: dict[str, set[str]] = defaultdict(set)
    for module in every:
        for name in module.imports & names.keys():
            importers[name].add(module.name)
    return [
        n
        for n, who in importers.items()
        if len(who) == 1 and len(names[n].code_lines) < SHORT_MODULE
    ]


def called_once(module: Module) -> list[str]:
    """Short private functions whose name stands once beside their definition."""
    found = []
    for node in module.tree.body:
        if not isinstance(node, ast.FunctionDef) or not node.name.startswith("_"):
            continue
        length = (node.end_lineno or node.lineno) - node.lineno + 1
        uses = len(re.findall(rf"\b{re.escape(node.name)}\b", module.text)) - 1
        if length <= SHORT_FUNCTION and uses <= 1:
            found.append(node.name)
    return found


def many_parameters(module: Module) -> list[str]:
    """Functions of more than `MOST_PARAMETERS`; the options of a command are its own count."""
    found = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.FunctionDef) and module.package != "cli":
            a = node.args
            if len([*a.posonlyargs, *a.args, *a.kwonlyargs]) > MOST_PARAMETERS:
                found.append(node.name)
    return found


def many_positional(module: Module) -> list[int]:
    """Lines of calls with more than `MOST_POSITIONAL` arguments that are not named."""
    calls = (n for n in ast.walk(module.tree) if isinstance(n, ast.Call))
    return [call.lineno for call in calls if len(call.args) > MOST_POSITIONAL]


def many_fields(module: Module) -> list[str]:
    """Dataclasses of more than `MOST_FIELDS`."""
    found = []
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.ClassDef):
            continue
        decorated = any("dataclass" in ast.unparse(d) for d in node.decorator_list)
        fields = sum(isinstance(statement, ast.AnnAssign) for statement in node.body)
        if decorated and fields > MOST_FIELDS:
            found.append(node.name)
    return found


def constants(module: Module) -> int:
    """Numbers that have a name in the module."""
    count = 0
    for node in module.tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
            values = (
                node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            )
            count += sum(
                isinstance(v, ast.Constant) and type(v.value) in (int, float)
                for v in values
            )
    return count


def sentences_read(module: Module) -> list[int]:
    """Lines in which code looks into a note, a reason or a message."""
    found = []
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        if node.func.attr in READS_TEXT and SENTENCE.search(
            ast.unparse(node.func.value)
        ):
            found.append(node.lineno)
    return found


def defined_twice(every: list[Module]) -> list[str]:
    """Names of classes of the top of modules that stand in two."""
    names = Counter(
        n.name for m in every for n in m.tree.body if isinstance(n, ast.ClassDef)
    )
    return sorted(name for name, count in names.items() if count > 1)


def cycles(every: list[Module]) -> list[list[str]]:
    """Groups of modules that import each other (Tarjan 1972)."""
    names = {m.name for m in every}
    graph = {m.name: sorted((m.imports & names) - {m.name}) for m in every}
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in graph[name]:
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            at = stack.index(name)
            group = stack[at:]
            del stack[at:]
            if len(group) > 1:
                groups.append(group)

    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, 10 * len(every)))
    for name in graph:
        if name not in index:
            visit(name)
    sys.setrecursionlimit(limit)
    return groups


def _run(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes of what runs: without the bodies of `if TYPE_CHECKING`."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            todo.extend(node.orelse)
        else:
            todo.extend(ast.iter_child_nodes(node))


def budgets() -> dict[str, dict[str, int]]:
    """What the figures may be."""
    return tomllib.loads(BUDGETS.read_text(encoding="utf-8"))


def lowered(
    now: dict[str, dict[str, int]], allowed: dict[str, dict[str, int]]
) -> dict[str, dict[str, int]]:
    """Budgets that fall to what is there; those of packages that are gone go."""
    new: dict[str, dict[str, int]] = {}
    for part, figures in now.items():
        new[part] = {}
        for name, figure in figures.items():
            budget = rounded(figure) if name == "tokens" or part == "tokens" else figure
            new[part][name] = min(budget, allowed.get(part, {}).get(name, budget))
    return new


def rounded(tokens: int) -> int:
    """Tokens with room for a small change."""
    return TOKEN_STEP * math.ceil(tokens / TOKEN_STEP)


def written(values: dict[str, dict[str, int]]) -> str:
    """The file of budgets."""
    head = "# What tests/architecture/measures.py counts may be at most this; see CONTRIBUTING.md.\n"
    parts = []
    for part, figures in values.items():
        rows = "".join(f'"{name}" = {figure}\n' for name, figure in figures.items())
        parts.append(f"\n[{part}]\n{rows}")
    return head + "".join(parts)


def main() -> None:
    """Print the figures, or lower the budgets."""
    now = measured(modules())
    allowed = budgets() if BUDGETS.exists() else {}
    if "--lower" in sys.argv:
        BUDGETS.write_text(written(lowered(now, allowed)), encoding="utf-8")
    for part, figures in now.items():
        for name, figure in figures.items():
            limit = allowed.get(part, {}).get(name, "none")
            print(f"{part:8} {name:40} {figure:>9,}  budget {limit}")


if __name__ == "__main__":
    main()
