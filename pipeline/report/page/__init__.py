"""`report.html`, one file that fetches nothing: facts, 3-D scene, timeline, keyframes. Public: `page.write_page`."""
