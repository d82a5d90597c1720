"""The documentation site, `make site`: the Markdown files where they are, and warnings are errors."""

from pathlib import Path

root = Path(__file__).parents[2]
navigation = (root / "docs/site/navigation.md").read_text()

project = html_title = "plenocal"
extensions = ["myst_parser"]
root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "docs/site/api.md"]
# Folders without pages are not searched.
exclude_patterns = [path.name for path in root.iterdir() if path.is_dir() and path.name != "docs"]

# Anchors and text as in a repository's browser, where a line may begin with a per cent sign.
myst_heading_anchors = 6
myst_disable_syntax = ["myst_line_comment", "myst_block_break", "myst_target", "myst_role"]
# Images of HTML are checked and copied too.
myst_enable_extensions = ["html_image"]
smartquotes = False
highlight_language = "none"

html_theme = "furo"
html_static_path = ["site.css", "site.js"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = html_show_copyright = html_use_index = False

# The API documentation that there is, for {only} in api.md.
for tag, index in [("rust", "target/doc/plenocal/index.html"), ("cpp", "build/doc-cpp/html/index.html")]:
    if (root / index).is_file():
        tags.add(tag)  # noqa: F821, Sphinx defines it


def setup(app):
    """Only the site needs the navigation, and the README's images without a paragraph of HTML around them."""

    def read(_, page, source):
        if page == root_doc:
            source[0] = source[0].replace("<p>\n", "").replace("</p>\n", "") + navigation

    app.connect("source-read", read)
