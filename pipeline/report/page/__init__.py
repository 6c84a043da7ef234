"""`report.html`, one file that fetches nothing: facts, 3-D scene, timeline, keyframe gallery. Public: `page.write_page`."""
