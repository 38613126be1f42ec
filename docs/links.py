"""Check the links inside a built site, anchors too: ``python docs/links.py build/docs``."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, path):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        """Collect links and anchors of a tag."""
        given = dict(attrs)
        # a name is an anchor of <a> only, not of <meta name="viewport">
        self.anchors |= {given[name] for name in (("id", "name") if tag == "a" else ("id",)) if given.get(name)}
        self.links += [given[name] for name in ("href", "src") if given.get(name)]


def dead_links(site):
    """Return the dead links, as (page, link), and the number of pages."""
    # _static has the theme's templates
    pages = {path.resolve(): Page(path) for path in site.rglob("*.html") if "_static" not in path.parts}
    dead = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            if parts.path.startswith("/"):
                dead.append((path.relative_to(site.resolve()), link))
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchor = unquote(parts.fragment)
            if not target.is_file() or (anchor and target in pages and anchor not in pages[target].anchors):
                dead.append((path.relative_to(site.resolve()), link))
    return len(pages), dead


if __name__ == "__main__":
    count, dead = dead_links(Path(sys.argv[1]))
    for page, link in dead:
        print(f"{page}: {link} leads nowhere")
    print(f"{count} pages, {len(dead)} dead links")
    sys.exit(1 if dead or not count else 0)
