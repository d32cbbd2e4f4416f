"""The page's style sheet: on a phone the controls take the whole width, and fingers hit them."""

from optipromp.looks.page.look import NARROW, SHEET

TOUCH = 44  # [pixel] height of what is touched on a phone; a finger needs 40

STYLE = f"""<style>
@media (max-width: {NARROW}px) {{
  .mantine-Paper-root[style*="max-height: 60%"] {{
    width: 100% !important; max-height: {100 * SHEET:.0f}% !important;
  }}
  .mantine-Paper-root [style*="width: 20em"] {{ width: 100% !important; }}
  .mantine-Button-root {{ height: {TOUCH}px !important; min-width: {TOUCH}px; font-size: 15px; }}
  .mantine-Input-input {{
    height: {TOUCH}px !important; min-height: {TOUCH}px !important; font-size: 16px !important;
  }}
  .mantine-Slider-root + * {{ width: 4.2rem !important; }}
  .mantine-Slider-root, .mantine-Slider-trackContainer {{ min-height: {TOUCH}px; }}
  .mantine-Tabs-tab {{ min-height: {TOUCH}px; flex-grow: 1; font-size: 15px; }}
  .mantine-ActionIcon-root {{ width: {TOUCH}px; height: {TOUCH}px; }}
  .mantine-NumberInput-controls {{ display: none; }}
  .mantine-Select-option {{ min-height: {TOUCH}px; }}
  .mantine-Checkbox-inner, .mantine-Checkbox-input {{ width: {TOUCH}px; height: {TOUCH}px; }}
  .status {{ max-height: none !important; }}
}}
</style>"""
"""A block of the panel; viser has no setting for it."""
