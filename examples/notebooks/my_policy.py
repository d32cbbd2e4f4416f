"""A policy of your own, learnt by PPO; scripts/notebooks.py makes the notebook."""

# %% [markdown]
# # My policy
#
# A learner of somebody else's, stable-baselines3, learns to pick: one action is a whole pick, and
# the push model says what becomes of it. There are 100 scenes of one preset, whose fruits hang on
# limp stems.
#
# The same as a script: `python examples/notebooks/my_policy.py` (needs the package
# `optipromp-bench` and `pip install stable-baselines3 torch`; some ten minutes). Where
# stable-baselines3 is not installed, the script ends at once.

# %%
from importlib.util import find_spec

if find_spec("stable_baselines3") is None:
    raise SystemExit(0)

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

# %% [markdown]
# The name before the colon is the package that registers the environment.

# %%
env = gymnasium.make(
    "optipromp_bench:optipromp/PickProMP-v0",
    presets="limp",
    seeds=(200_000, 200_100),
    simulated=False,
)
print(env.observation_space["objects"].shape, env.action_space.shape)

# %% [markdown]
# Places are some centimetres, so observations are brought to unit variance. One episode is one
# step: nothing is discounted.

# %%
watched = VecMonitor(DummyVecEnv([lambda: env]), info_keywords=("is_success",))
agent = PPO(
    "MultiInputPolicy",
    VecNormalize(watched, norm_reward=False),
    n_steps=128,
    batch_size=64,
    learning_rate=1e-3,
    gamma=0.0,
    gae_lambda=0.0,
    policy_kwargs={"log_std_init": -2.0},
    seed=0,
    device="cpu",
)
rounds = []


def keep(told, _):
    """Reward and promised share of the last 100 picks, once a round."""
    picks = agent.num_timesteps
    if picks % 128 == 0:
        kept = [(each["r"], each["is_success"]) for each in agent.ep_info_buffer]
        reward, share = np.mean(kept, axis=0)
        rounds.append((picks, share))
        if picks % 1024 == 0:
            print(f"{picks:5d} picks: reward {reward:+.2f}, promised {share:.0%}")
    return True


_ = agent.learn(8_192, callback=keep)

# %% [markdown]
# The share of picks, of the last 100, that the push model promises to be clean.

# %%
picks, shares = np.array(rounds).T
plt.figure(figsize=(6.0, 3.0))
plt.plot(picks, 100.0 * shares)
plt.xlabel("picks")
plt.ylabel("promised clean [%]")
plt.tight_layout()
plt.gcf()

# %%
assert shares[-1] > 2.0 * shares[0]
