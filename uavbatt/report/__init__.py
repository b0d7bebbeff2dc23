"""PAGES: self-contained HTML with plots, of the values of the stages below."""
