"""PAGES: self-contained HTML pages with plots; they show the results of all packages below."""
