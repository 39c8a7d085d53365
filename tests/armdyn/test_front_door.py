import subprocess
import sys

import numpy as np

import armdyn


def test_the_import_alone_loads_no_library():
    code = "import sys, armdyn; print({'numpy', 'scipy', 'casadi', 'pinocchio'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "set()"


def test_everything_named_is_there():
    for name in armdyn.__all__:
        assert getattr(armdyn, name) is not None
    assert callable(armdyn.arm.arm_model)
    assert "linear_drag" in armdyn.effects.CATALOGUE


def test_a_model_is_fitted_from_paths_given_as_text(tmp_path):
    t = np.arange(0.0, 3.0, 0.01)
    angle = 0.1 * np.cos(5.0 * t) + 1e-4 * np.random.default_rng(0).normal(size=len(t))
    rows = "\n".join(f"{s:.2f},{a:.6f}" for s, a in zip(t, angle, strict=True))
    path = str(tmp_path / "swing.csv")
    (tmp_path / "swing.csv").write_text(f"time [s],swing_angle [rad]\n{rows}\n")
    model = armdyn.pendulum.pendulum_model(0.35, 0.1).with_fixed("mass")
    fitted = armdyn.fit(model, [path])
    assert abs(fitted.value("length") - 9.81 / 25.0) < 2e-3
    assert armdyn.compare(fitted, [armdyn.read_run(path)]).channels["swing_angle"].noise_std < 2e-4
