"""What people look at: the page, 3-D views, figures and reports."""
