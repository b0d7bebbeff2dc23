"""THE COMPANION PROCESS: daemon, configuration, saved state, requests, feeds, proxy, web page, recorder."""
