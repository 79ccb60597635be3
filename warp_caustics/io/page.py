"""Pages for people (HTML): one style, everything inside, nothing that could be taken for markup."""

from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2


def render_page(package: str, name: str, **values: Any) -> str:
    """Text of a page.

    Args:
        package: that holds the template.
        name: of the template; ``style`` in it is the common style sheet.
        values: what it shows; all text is escaped.
    """
    return _environment(package).get_template(name).render(style=page_file("warp_caustics.io", "style.css"), **values)


@cache
def _environment(package: str) -> "jinja2.Environment":
    """Compiles a package's templates, each once: that takes longer than to fill one in."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda file: page_file(package, file)),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # As they come: legends and buttons keep the order in which things were listed.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters["figure"] = lambda value: "" if value is None else f"{value:.4g}"
    return environment


def page_file(package: str, name: str) -> str:
    """Text of a file that pages are made of."""
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def inline_script(text: str) -> str:
    """JavaScript that may stand between script tags.

    Neither sequence means anything in JavaScript but within strings and regular
    expressions, where a backslash before such a character changes nothing.
    """
    return text.replace("</script", "<\\/script").replace("</SCRIPT", "<\\/SCRIPT").replace("<!--", "<\\!--")
