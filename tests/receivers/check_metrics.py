#!/usr/bin/env python3
"""The metrics beside the status file, read by Prometheus' own Python parser: every metric has its type and an explanation, all
samples of one stand together, none twice.

    check_metrics.py MIEN
"""
import pathlib
import subprocess
import sys
import tempfile

from prometheus_client.parser import text_string_to_metric_families

EXPECTED = {"mien_build_info", "mien_frames_captured", "mien_capture_to_send_seconds", "mien_face_present", "mien_tracking_lost",
            "mien_sensor_connected", "mien_uptime_seconds", "mien_users", "mien_output_sent", "mien_output_errors",
            "mien_output_refused", "mien_output_connected"}


def check(text):
    families = list(text_string_to_metric_families(text))
    names = [family.name for family in families]
    assert len(set(names)) == len(names), f"a metric is begun twice: {names}"
    assert set(names) == EXPECTED, set(names) ^ EXPECTED
    samples = []
    for family in families:
        assert family.type != "unknown" and family.type != "untyped" and family.documentation, family
        assert family.samples, f"{family.name} has no sample"
        samples += [(sample.name, *sorted(sample.labels.items())) for sample in family.samples]
    assert len(set(samples)) == len(samples), "a sample stands there twice"
    return len(families), len(samples)


def main():
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        status = folder / "status.json"
        sections = "".join(f'[{name}]\nenabled = true\ntarget = "127.0.0.1:9"\n' for name in ("vmc", "vrchat", "faceosc"))
        (folder / "mien.toml").write_text(f'[status]\npath = "{status}"\n[osc]\ntarget = "127.0.0.1:9"\ncommands = false\n{sections}')
        words = ["run", "-q", "--source", "simulated", "--frames", "60", "--fast", "--config", folder / "mien.toml"]
        subprocess.run([sys.argv[1], *words, "--csv", folder / "run.csv"], check=True, timeout=300)
        families, samples = check((folder / "mien.prom").read_text())
    print(f"   {families} metrics, {samples} samples")


if __name__ == "__main__":
    main()
