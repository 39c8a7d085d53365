"""three.js, the library that draws in three dimensions, out of the package trimesh, which brings it along."""

from functools import cache

from armdyn.errors import InputError

BEGIN, END = "/**\n * @license", "\n"
"""What stands around the library in trimesh's own viewer: its licence, and the end of the one line that it is."""


@cache
def three_js() -> str:
    """The library as one script that defines ``THREE``; MIT licence, its notice included.

    Raises:
        InputError: trimesh brings it in another form.
    """
    import io
    import zipfile

    from trimesh import resources

    try:
        with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
            page = archive.read("viewer.html.template").decode("utf-8")
        start = page.index(BEGIN)
        body = page.index("!function", start)
        script = page[start : page.index(END, body)]
    except (OSError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"trimesh brings no three.js ({error}): install trimesh 4.5 or later") from error
    # Inside JavaScript's strings and in comments a tag that ends a script would end ours.
    return script.replace("</script", "<\\/script")
