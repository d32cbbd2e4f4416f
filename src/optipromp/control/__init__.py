"""The closed loop: looks are tracked, and the arm's curve is planned again while it moves."""

from optipromp.control.look import Look as Look
