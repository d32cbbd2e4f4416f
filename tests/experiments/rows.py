"""A row of a study."""

from optipromp_bench.experiments.rows import Row

ROW = Row(
    preset="cluster", seed=0, planner="straight", noise_position=0.0, noise_angle=0.0, pushables=2,
    redraws=5, plan_status="success", success=False, cause="crushed", message='n1, "hard"',
    picked=True, swallowed="", unripe_force=12.5, target_force=0.1, static_force=0.0, torn="",
    stem_force=1.0, duration=3.0, predicted_harm=0.2, predicted_failure=0.03, plan_time=0.1,
    simulation_time=1.0, version="x", retreats=0, looks=9, cycle_median=0.001, cycle_p99=0.01,
    nis=3.1, worst_jump=1e-9, worst_limit=0.9, views=1, pictures=2, visible=4, found=3, false=1,
    see_time=0.2, success_before=False,
)  # fmt: skip
