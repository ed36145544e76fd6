"""The policies by their names; one of your own is FILE.py:NAME.

Rule: swings-abr and swings-serve get policies here, and nowhere else.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import MappingProxyType, ModuleType

from codec.errors import InvalidError
from codec.files import describe_os_error
from server.abr.decisioncontext import Policy
from server.abr.sweep import Sweep

from .policies import BolaRule, InOrder, RobustMpcRule, Rule, TailDropRule, ThroughputRule

OWN = "sweep"
"""The server's own."""
POLICIES: Mapping[str, Callable[[], Rule | Policy]] = MappingProxyType(
    {
        "throughput": ThroughputRule,
        "bola": BolaRule,
        "robust_mpc": RobustMpcRule,
        "tail_drop": TailDropRule,
        OWN: Sweep,
    }
)
"""The policies that come along: published ones, and ours."""


def make_policy(text: str) -> Policy:
    """A policy for one play. text: a name of POLICIES, or FILE.py:NAME, what the class or function
    NAME of that file gives when it is called: a `Rule`, or a `Policy`.

    The file is run once in each process. Raises InvalidError.
    """
    made = (POLICIES.get(text) or _maker_in_file(text))()
    return InOrder(made) if isinstance(made, Rule) else made


def check_policy(text: str) -> str:
    """`text` itself, if a policy can be made of it. Raises InvalidError."""
    try:
        policy = make_policy(text)
    except InvalidError:
        raise
    except OSError as error:
        raise InvalidError(f"policy {text}: {describe_os_error(error)}") from error
    except Exception as error:
        raise InvalidError(f"policy {text}: {type(error).__name__}: {error}") from error
    if not (hasattr(policy, "choose") and hasattr(policy, "mends")):
        raise InvalidError(f"policy {text} is neither a Rule nor a Policy, see docs/EXTENDING.md")
    return text


def short_name(text: str) -> str:
    """What a table calls the policy `text`."""
    return text.rpartition(":")[2]


def _maker_in_file(text: str) -> Callable[[], Rule | Policy]:
    file, _, name = text.rpartition(":")
    if not file.endswith(".py"):
        known = ", ".join(POLICIES)
        raise InvalidError(f"policy {text!r} is unknown; choose from {known}, or give FILE.py:NAME")
    maker: Callable[[], Rule | Policy] | None = getattr(_module(file), name, None)
    if maker is None:
        raise InvalidError(f"policy {text}: the file has no {name!r}")
    return maker


@cache
def _module(file: str) -> ModuleType:
    spec = spec_from_file_location(f"policyfile.{Path(file).stem}", file)
    assert spec is not None, "its name ends in .py"
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    spec.loader.exec_module(module)
    return module
