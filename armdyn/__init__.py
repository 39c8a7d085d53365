"""armdyn: learn what a robot arm handles, use it, and find out where the model is wrong.

```python
import armdyn

model = armdyn.pendulum.pendulum_model(length=0.35, mass=0.1)  # or armdyn.read_model("model.toml")
found = armdyn.repair(model, ["swing_1.csv", "swing_2.csv"])
print(found.sentence)
```

Everything is loaded when it is first used (PEP 562), so that the import itself takes no time.
"""

from typing import TYPE_CHECKING, Any

from urdf.lazy import lazy_getattr

if TYPE_CHECKING:
    from armdyn import arm, effects, pendulum
    from armdyn.effects.catalogue import CATALOGUE
    from armdyn.effects.effect import Effect, effect
    from armdyn.effects.user import load_effects
    from armdyn.errors import InputError
    from armdyn.front import (
        add,
        compare,
        diagnose,
        discover,
        fit,
        inspect,
        load,
        predict,
        repair,
        residual,
        save,
        simulate,
    )
    from armdyn.identify.compare import Comparison
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.repair import Repair
    from armdyn.inspection.check import Inspection
    from armdyn.model import Model
    from armdyn.model_file import read_model
    from armdyn.parameter import column, quantity
    from armdyn.run import Run, read_run

__version__ = "0.1.0"

_MODULES = {
    "CATALOGUE": "armdyn.effects.catalogue", "Effect": "armdyn.effects.effect", "effect": "armdyn.effects.effect",
    "load_effects": "armdyn.effects.user", "InputError": "armdyn.errors",
    "quantity": "armdyn.parameter", "column": "armdyn.parameter",
    "Run": "armdyn.run", "read_run": "armdyn.run", "Model": "armdyn.model", "read_model": "armdyn.model_file",
    "add": "armdyn.front", "fit": "armdyn.front", "inspect": "armdyn.front", "compare": "armdyn.front",
    "diagnose": "armdyn.front",
    "discover": "armdyn.front", "Discovery": "armdyn.discovery.result",
    "load": "armdyn.front", "save": "armdyn.front", "predict": "armdyn.front", "simulate": "armdyn.front",
    "residual": "armdyn.front",
    "repair": "armdyn.front", "Inspection": "armdyn.inspection.check", "Comparison": "armdyn.identify.compare",
    "Diagnosis": "armdyn.identify.diagnose", "Repair": "armdyn.identify.repair",
    "arm": "armdyn.arm", "effects": "armdyn.effects", "pendulum": "armdyn.pendulum",
}  # fmt: skip
"""Where each name is defined."""
__all__ = [
    "CATALOGUE", "Comparison", "Diagnosis", "Discovery", "Effect", "InputError", "Inspection", "Model", "Repair", "Run",
    "add", "arm", "check", "column", "compare", "diagnose", "discover", "effect", "effects", "excite", "export", "fit",
    "import_log", "inspect", "load", "load_effects", "next_experiment", "pendulum", "predict", "quantity", "read_model",
    "read_run", "repair", "residual", "save", "simulate",
]  # fmt: skip
_own = lazy_getattr(__name__, _MODULES)


def __getattr__(name: str) -> Any:
    if name in __all__ and name not in _MODULES:  # a package above registers it as an entry point of the group "armdyn"
        from importlib.metadata import entry_points

        for entry in entry_points(group=__name__, name=name):
            return entry.load()
    return _own(name)


def __dir__() -> list[str]:
    return sorted(__all__)
