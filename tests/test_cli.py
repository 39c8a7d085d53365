from pipeline.console.screen import screen_console


def test_help_says_what_each_command_does(armdyn):
    status, out, _ = armdyn("--help")
    assert status == 0
    for command in ("trial", "table", "ik", "check", "loadcell"):
        assert command in out


def test_brackets_reach_the_terminal(armdyn, capsys):
    _, out, _ = armdyn("trial", "--help")
    assert "[m]" in out
    screen_console().print("friction [swing_rate > 0], q [m], parameter.torque[bold]")
    assert capsys.readouterr().out == "friction [swing_rate > 0], q [m], parameter.torque[bold]\n"


def test_a_missed_box_is_status_one(armdyn):
    status, out, _ = armdyn("trial", "--no-estimation", "--length-guess", "0.428")
    assert status == 1
    assert "report" in out


def test_out_and_output_are_one():
    """Whichever a command is known for, both are understood."""
    import typer

    from pipeline.console.app import build_application, command_modules

    def options(command, path=()):
        for name, sub in getattr(command, "commands", {}).items():
            yield from options(sub, (*path, name))
        yield from ((path, set(parameter.opts)) for parameter in command.params)

    found = [
        (path, opts)
        for path, opts in options(typer.main.get_command(build_application(command_modules().values())))
        if opts & {"--out", "--output"}
    ]
    assert len(found) >= 12
    assert [path for path, opts in found if not {"--out", "--output"} <= opts] == []
