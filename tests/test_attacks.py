"""Past attacks and faults of the programs, and the tests that prevent their return.

Each row describes an attack, or a fault with an untrusted file, a new user or a full disk, and has
the tests (FILE::NAME, below tests) that fail if it ever works again. A renamed test must be renamed
here, too.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent

HELD_BY = {
    # Attacks on the server.
    "idle connections take all descriptors; the log is flooded, nobody else is served": (
        "server/operate/test_operated.py::test_idle_clients_beyond_all_descriptors_are_waited_out_quietly",
        "server/operate/test_admission.py::test_connections_stay_below_the_limit_of_open_files",
        "server/operate/test_operated.py::test_connections_above_the_limit_wait_and_are_served",
        "server/library/test_library.py::test_a_process_without_descriptors_keeps_what_it_serves",
    ),
    "one bad folder beside good ones keeps the server from starting": (
        "server/test_main.py::test_a_broken_stream_is_named_and_the_others_are_served",
        "server/library/test_library.py::test_a_broken_stream_is_named_with_its_reason_and_the_others_are_served",
        "server/library/test_library.py::test_a_name_that_needs_quoting_is_refused_and_shown_without_harm",
    ),
    "a Host that is not one makes a page a 500 with a traceback": (
        "server/hostile/test_hostile_requests.py::test_it_is_answered_as_http_says_and_nothing_else_happens",
        "server/exchange/test_request.py::test_any_text_gives_a_request_or_an_error",
        "server/clients/test_fuzz.py::test_each_is_answered_well",
    ),
    "a stream that was seen half copied is never served": (
        "server/library/test_watch.py::test_a_half_copied_stream_is_broken_until_it_is_whole",
        "server/library/test_watch.py::test_an_index_that_is_copied_before_its_objects_waits_for_them",
    ),
    "a deleted stream stays listed; a replaced one has new bytes under an old tag, or is mixed": (
        "server/library/test_watch.py::test_streams_come_go_break_and_are_repaired",
        "server/library/test_watch.py::test_a_replaced_stream_is_another_one",
        "server/library/test_streamview.py::test_whatever_is_put_in_its_place_a_tag_never_changes_its_bytes",
        "server/test_growing.py::test_a_replaced_stream_ends_its_plays_and_no_tag_has_two_contents",
    ),
    "a manifest without an end takes all memory": (
        "server/library/test_library.py::test_a_broken_stream_is_named_with_its_reason_and_the_others_are_served",
    ),
    "a FIFO in place of an object blocks a thread for ever": (
        "server/library/test_library.py::test_objects_are_regular_files_of_the_right_size",
    ),
    "a slow but honest reader is cut, and can never have a large object": (
        "server/hostile/test_slow_clients.py::test_a_reader_of_10_kb_a_second_gets_its_whole_object",
        "server/clients/test_bodies.py::test_a_client_stalls_that_had_something_to_take_and_did_not",
    ),
    "a time without an end is a traceback": (
        "server/test_main.py::test_wrong_usage_exits_with_2",
        "server/clients/test_connection.py::test_times_that_make_no_sense_are_refused",
    ),
    "plays that are stuck keep a server that was told to end": (
        "server/operate/workers/test_workers.py::test_it_ends_in_time_though_50_clients_read_nothing",
    ),
    "of two lines of If-None-Match only the first is read; If-Match is not read at all": (
        "server/exchange/test_content.py::test_it_is_as_the_rfc_says",
        "server/exchange/test_request.py::test_lines_of_one_field_are_one_list",
        "server/hostile/test_hostile_requests.py::test_it_is_answered_as_http_says_and_nothing_else_happens",
    ),
    "HTTP/2.0 on the port gets a 200": (
        "server/hostile/test_hostile_requests.py::test_it_is_answered_as_http_says_and_nothing_else_happens",
    ),
    "one client takes all plays, or all connections": (
        "server/operate/test_operated.py::test_one_client_of_a_proxy_has_so_many_plays",
        "server/operate/test_operated.py::test_a_stranger_cannot_say_who_it_is",
        "server/operate/test_operated.py::test_one_address_has_so_many_connections",
        "server/operate/test_admission.py::test_it_counts_as_a_simple_model_does",
    ),
    "plays that began together burst in step": (
        "server/abr/test_reported_status.py::test_clients_that_began_together_drift_apart",
    ),
    "what strangers send reaches the operator's terminal as escapes": (
        "server/operate/log/test_logline.py::test_whatever_a_field_holds_the_line_is_one_and_printable",
        "server/library/test_library.py::test_the_reason_of_a_stranger_is_one_line_of_letters",
        "server/operate/test_operated.py::test_every_line_of_a_json_log_is_json",
    ),
    "requests without an end, whose answers nobody takes, fill the memory": (
        "server/clients/test_connection.py::test_a_flood_of_requests_is_bounded_and_others_have_their_turn",
    ),
    "handshakes that fail use up what one address may have": (
        "server/clients/test_bodies.py::test_strangers_at_the_tls_port_leave_nothing_behind",
    ),
    # Faults that new users met.
    "a sheet takes the size of its first row; pictures of other cameras are cut": (
        "trainer/score/test_sheet.py::test_cameras_of_any_size_are_whole",
    ),
    "a capture of a served stream is not the folder's, and the report hides it": (
        "player/test_command.py::test_a_capture_of_a_served_stream_is_that_of_its_folder",
        "player/playout/test_timeline.py::test_frames_come_only_when_they_are_due",
    ),
    "the help of export names a file that it does not write": (
        "codec/test_main.py::test_the_help_of_export_names_the_first_file_that_it_writes",
    ),
    "training cameras far apart train to smears without a warning": (
        "trainer/rig/test_doubts.py::test_few_and_distant_cameras",
    ),
    "who reads the first line only gets a complaint of a broken pipe": (
        "codec/test_console.py::test_who_reads_the_first_line_only_gets_it_and_no_complaint",
    ),
    "output that is not a terminal says nothing till the end, and one line is too wide": (
        "codec/test_progressline.py::test_the_line_fits_and_leaves_out_whole_parts_only",
        "trainer/run/test_runstatus.py::test_on_a_terminal_of_80_columns_it_is_one_line",
        "trainer/run/test_runstatus.py::test_a_run_whose_output_is_a_file_says_how_it_goes",
    ),
    "the dB of the progress line jump from one held-out camera to the other": (
        "trainer/score/test_meter.py::"
        "test_the_mean_is_over_all_held_out_cameras_from_the_first_frame_on",
    ),
    "--resume wants every option again": (
        "trainer/run/test_resume.py::test_resuming_what_is_not_there_or_other_is_one_line",
        "trainer/run/test_storedconfig.py::test_settings_come_back",
    ),
    "the table of scores hides a bad camera in a mean": (
        "trainer/score/test_moving.py::test_the_table_tells_what_moves_and_each_camera",
    ),
    "info and eval differ without a word": (
        "trainer/score/test_same_figures.py::test_info_and_eval_agree_or_info_says_why_not",
    ),
    # Untrusted files.
    "16-bit pictures become white, alpha is dropped, a float picture of NaN trains to 100 dB": (
        "trainer/test_pixels.py::test_16_bit_grey_is_rounded_to_8",
        "trainer/test_pixels.py::test_16_bit_colour_is_that_of_8",
        "trainer/test_pixels.py::test_what_is_transparent_is_laid_on_black",
        "trainer/test_pixels.py::test_what_is_not_8_or_16_bit_rgb_or_grey_is_refused",
    ),
    "a picture of too many pixels is a traceback amid training": (
        "trainer/test_pixels.py::test_a_picture_of_a_billion_pixels_is_one_line",
    ),
    "verify, info, import and train hang on a pipe": (
        "codec/storage/test_folder.py::test_no_command_waits_for_a_pipe",
        "codec/storage/test_folder.py::test_an_import_does_not_wait_for_a_pipe",
        "trainer/test_hostile_captures.py::test_nobody_waits_for_the_other_end_of_a_pipe",
        "trainer/test_hostile_captures.py::test_points_are_not_read_from_a_pipe",
        "trainer/test_pixels.py::test_nobody_waits_for_a_pipe",
    ),
    "gigabytes of a file are read before its header is looked at": (
        "codec/interop/test_formats.py::test_a_huge_file_is_refused_by_its_first_bytes",
        "codec/sequence/test_importing.py::test_too_many_are_refused_by_the_header_alone",
    ),
    "points of 700 kB take 3 GB; a .npy claims 10^11 rows": (
        "trainer/test_hostile_captures.py::test_points_that_unpack_to_gigabytes_are_refused",
        "trainer/test_hostile_captures.py::test_points_whose_header_claims_more_than_there_is",
        "trainer/test_hostile_captures.py::test_rows_that_a_header_only_claims_are_not_made",
    ),
    "a focal length of 1e-300 is a traceback": (
        "trainer/test_hostile_captures.py::test_a_focal_length_of_no_lens_is_refused",
    ),
    "what a stream calls itself steers the terminal": (
        "player/source/test_strange_hosts.py::"
        "test_what_a_stream_calls_itself_does_not_steer_the_terminal",
    ),
    # Disks and signals.
    "of a full disk one is not told the file": (
        "test_full_disk.py::test_a_full_disk_is_one_line_with_the_file_and_leaves_nothing",
        "test_full_disk.py::test_an_import_without_room_names_the_file",
        "test_full_disk.py::test_a_log_keeps_whole_lines_only",
        "codec/test_files.py::test_a_full_disk_names_the_file",
        "codec/test_console.py::test_a_full_disk_under_the_output_is_one_line",
        "player/run/test_stills.py::test_a_full_disk_leaves_nothing_and_names_the_file",
    ),
    "a disk that is full before the first checkpoint: --resume refuses": (
        "trainer/run/test_resume.py::"
        "test_a_run_that_had_no_room_for_its_first_checkpoint_begins_anew",
        "test_full_disk.py::test_training_without_room_is_told_and_goes_on_later",
    ),
    "SIGTERM leaves what was being written": (
        "codec/test_console.py::test_a_signal_ends_a_command_when_it_has_cleaned_up",
        "codec/test_files.py::test_what_fails_leaves_the_old_file_and_nothing_else",
        "player/run/test_interrupt.py::test_a_signal_writes_the_report_and_no_half_video",
    ),
}


@pytest.mark.parametrize("attack", HELD_BY)
def test_it_is_held(attack: str) -> None:
    for test in HELD_BY[attack]:
        file, name = test.split("::")
        tree = ast.parse((HERE / file).read_text(encoding="utf-8"))
        functions = ast.FunctionDef | ast.AsyncFunctionDef
        names = {node.name for node in tree.body if isinstance(node, functions)}
        assert name in names, test
