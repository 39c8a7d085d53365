"""armdyn: learn what a robot arm handles, use it, and find out where the model is wrong.

```python
import armdyn

model = armdyn.pendulum.pendulum_model(length=0.35, mass=0.1)  # or armdyn.read_model("model.toml")
found = armdyn.repair(model, ["swing_1.csv", "swing_2.csv"])
print(found.sentence)
```

Everything is loaded when it is first asked for (PEP 562), so that the import itself takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armdyn import arm, effects, pendulum
    from armdyn.effects.catalogue import CATALOGUE
    from armdyn.effects.effect import Effect, effect
    from armdyn.front import compare, diagnose, fit, inspect, repair
    from armdyn.identify.compare import Comparison
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.repair import Repair
    from armdyn.inspection.check import Inspection
    from armdyn.model import Model
    from armdyn.model_file import read_model
    from armdyn.parameter import quantity
    from armdyn.run import Run, read_run

__version__ = "0.1.0"
__all__ = [
    "CATALOGUE", "Comparison", "Diagnosis", "Effect", "Inspection", "Model", "Repair", "Run", "arm", "compare",
    "diagnose", "effect", "effects", "fit", "inspect", "pendulum", "quantity", "read_model", "read_run", "repair",
]  # fmt: skip

_MODULES = {
    "CATALOGUE": "armdyn.effects.catalogue", "Effect": "armdyn.effects.effect", "effect": "armdyn.effects.effect",
    "quantity": "armdyn.parameter", "Run": "armdyn.run", "read_run": "armdyn.run", "Model": "armdyn.model",
    "read_model": "armdyn.model_file", "Comparison": "armdyn.identify.compare", "compare": "armdyn.front",
    "Diagnosis": "armdyn.identify.diagnose", "diagnose": "armdyn.front", "Repair": "armdyn.identify.repair",
    "repair": "armdyn.front", "fit": "armdyn.front", "inspect": "armdyn.front",
    "Inspection": "armdyn.inspection.check",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    if name in __all__:
        return import_module(f"armdyn.{name}")
    raise AttributeError(f"module 'armdyn' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
