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
    from armdyn.front import compare, diagnose, fit, repair
    from armdyn.model_file import read_model
    from armdyn.run import Run, read_run

__version__ = "0.1.0"
__all__ = ["Run", "arm", "compare", "diagnose", "effects", "fit", "pendulum", "read_model", "read_run", "repair"]

_MODULES = {
    "Run": "armdyn.run", "read_run": "armdyn.run", "read_model": "armdyn.model_file", "compare": "armdyn.front",
    "diagnose": "armdyn.front", "repair": "armdyn.front", "fit": "armdyn.front",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    if name in __all__:
        return import_module(f"armdyn.{name}")
    raise AttributeError(f"module 'armdyn' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
