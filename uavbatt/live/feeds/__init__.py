"""Feeds: what live says, and to whom: named values, announcements, the proxy, the web page."""
