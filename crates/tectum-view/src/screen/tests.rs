//! What the screen shows, as text: at 80 x 24, at 40 columns, and at any other size.

use ratatui_core::backend::TestBackend;
use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::Color;
use ratatui_core::terminal::Terminal;

use super::{ScreenOptions, draw_notice, draw_screen};
use crate::run_view::tests::{facts, take_tick};
use crate::{RunFacts, RunView, SeenProcess, WatchedState};

/// The run of the screenshot in docs/watch.md, with a restart and a missed command.
fn watched(ticks: u64) -> RunView {
    let mut view = RunView::new(facts());
    (0..ticks).for_each(|tick| take_tick(&mut view, tick));
    let process = |pid, lost| SeenProcess { state: WatchedState::Running, pid, ticks, lost, ..SeenProcess::default() };
    let processes = [SeenProcess { missed: 2, ..process(4101, 0) }, process(4102, 1), process(4103, 0)];
    view.boards([SeenProcess { ticks: ticks.saturating_sub(20), ..processes[0] }, processes[1], processes[2]], 0.0);
    view.boards([processes[0], SeenProcess { state: WatchedState::Died, ..processes[1] }, processes[2]], 0.9);
    view.boards([processes[0], SeenProcess { restarts: 1, pid: 4177, ..processes[1] }, processes[2]], 1.0);
    view.say("tectum: the controller was killed by signal 9 at tick 240; it is started again");
    view
}

fn screen(view: &RunView, options: ScreenOptions, [width, height]: [u16; 2]) -> Terminal<TestBackend> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw_screen(view, options, frame.area(), frame.buffer_mut())).unwrap();
    terminal
}

fn text(terminal: &Terminal<TestBackend>) -> String {
    let buffer = terminal.backend().buffer();
    let row = |y| (0..buffer.area.width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..buffer.area.height).map(|y| row(y).trim_end().to_owned() + "\n").collect()
}

/// Compares with a file, which `TECTUM_SNAPSHOTS=write` writes anew.
fn assert_snapshot(name: &str, found: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/screen/snapshots").join(name);
    if std::env::var_os("TECTUM_SNAPSHOTS").is_some() {
        std::fs::write(&path, found).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(found, expected, "{} differs; TECTUM_SNAPSHOTS=write writes it anew", path.display());
}

#[test]
fn the_screen_is_as_in_the_manual() {
    let view = watched(241);
    let wide = text(&screen(&view, ScreenOptions::default(), [80, 24]));
    assert_snapshot("wide.txt", &wide);
    assert_snapshot("narrow.txt", &text(&screen(&view, ScreenOptions::default(), [40, 30])));
    let manual = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/watch.md");
    let manual = std::fs::read_to_string(manual).unwrap_or_default();
    assert!(manual.contains(wide.trim_end()), "docs/watch.md shows another screen than snapshots/wide.txt");
}

#[test]
fn everything_that_matters_is_on_the_smallest_usual_terminals() {
    let view = watched(241);
    for size in [[80, 24], [40, 24]] {
        let shown = text(&screen(&view, ScreenOptions::default(), size));
        for word in [
            "tick 241 of 3,600",
            "sensing",
            "answer",
            "learning",
            "slack",
            "missed 2",
            "late 0",
            "start 2",
            "controller",
            "20.0 ticks/s",
        ] {
            assert!(shown.contains(word), "{word} is missing at {size:?}:\n{shown}");
        }
    }
}

/// No size and no state makes it panic or draw outside.
#[test]
fn any_size_is_drawn() {
    let lockstep = RunView::new(RunFacts { realtime: false, arm: None, ..facts() });
    let mut ended = watched(60);
    ended.end("the run is over");
    for view in [&RunView::default(), &lockstep, &watched(3), &ended] {
        for width in (0..130).step_by(7) {
            for height in 0..40 {
                for options in [ScreenOptions::default(), ScreenOptions { help: true, plain: true, paused: true }] {
                    let area = Rect::new(0, 0, width, height);
                    let mut buffer = Buffer::empty(area);
                    draw_screen(view, options, area, &mut buffer);
                    draw_notice("There is no run that is alive.", options, area, &mut buffer);
                }
            }
        }
    }
}

#[test]
fn without_colours_nothing_has_one() {
    let view = watched(241);
    let coloured = |options| {
        let terminal = screen(&view, options, [80, 24]);
        terminal.backend().buffer().content.iter().any(|cell| cell.fg != Color::Reset || cell.bg != Color::Reset)
    };
    assert!(coloured(ScreenOptions::default()) && !coloured(ScreenOptions { plain: true, ..ScreenOptions::default() }));
}

#[test]
fn a_plant_that_is_no_arm_is_shown_as_bars() {
    let mut view = RunView::new(RunFacts { arm: None, ..facts() });
    (0..5).for_each(|tick| take_tick(&mut view, tick));
    let shown = text(&screen(&view, ScreenOptions::default(), [80, 24]));
    assert!(shown.contains("theta_1") && shown.contains('█') && shown.contains("rate_2"), "{shown}");
}
