// roslib 1.4.1 or 2.1.0 as the judge of a sweep. Node runs this module's text in a folder with roslib;
// arguments: PORT and the topic of results; the plan comes from standard input.
// roslib 1 supports only ROS 1's actions, which are topics, and has no actions here.
const TIMEOUT_MS = 20000, REPEAT_MS = 500;
const [port, result] = process.argv.slice(-2);
async function read(stream) {
  let text = '';
  for await (const each of stream) text += each;
  return JSON.parse(text);
}

async function main(ROSLIB) {
  const plan = await read(process.stdin);
  const told = {commands: {}, services: {}, actions: {}, heard: {}};
  const made = (kind, value) => ROSLIB[kind] ? new ROSLIB[kind](value) : value;
  const ros = new ROSLIB.Ros({url: `ws://127.0.0.1:${port}`});
  await new Promise((resolve, reject) => { ros.on('connection', resolve); ros.on('error', reject); });
  const hear = (name, messageType, take) =>
    new ROSLIB.Topic({ros, name, messageType}).subscribe(take);
  for (const [name, type] of plan.hear) hear(name, type, () => { told.heard[name] = true; });
  let taken = () => {};
  hear(result, 'cardan_msgs/msg/CommandResult', each => taken(each));

  for (const [name, messageType, message, verb, tag] of plan.commands) {
    const topic = new ROSLIB.Topic({ros, name, messageType});
    told.commands[name] = await new Promise(resolve => {
      taken = each => {
        if (each.command === verb && each.reason.includes(tag))
          end(`${each.outcome}: ${each.reason}`);
      };
      const publish = () => topic.publish(made('Message', message));
      const repeat = setInterval(publish, REPEAT_MS);
      const late = setTimeout(() => end(''), TIMEOUT_MS);
      const end = what => { clearInterval(repeat); clearTimeout(late); resolve(what); };
      publish();
    });
  }
  for (const [name, serviceType, request] of plan.services) {
    told.services[name] = await new Promise(resolve => {
      setTimeout(() => resolve(null), TIMEOUT_MS).unref();
      new ROSLIB.Service({ros, name, serviceType}).callService(
        made('ServiceRequest', request), resolve,
        error => { console.error(name, error); resolve(null); });
    });
  }
  for (const [name, actionType, goal] of plan.actions) {
    told.actions[name] = await new Promise(resolve => {
      setTimeout(() => resolve(null), TIMEOUT_MS).unref();
      // A refused goal ends as aborted, which this client reports as an error with the result.
      new ROSLIB.Action({ros, name, actionType}).sendGoal(
        goal, resolve, () => {}, error => resolve({error: String(error)}));
    });
  }
  console.log('HEARING');
  const until = Date.now() + TIMEOUT_MS;
  while (Date.now() < until && Object.keys(told.heard).length < plan.hear.length)
    await new Promise(resolve => setTimeout(resolve, 10));
  process.stdout.write(JSON.stringify(told) + '\n', () => process.exit(0));
}

import('roslib')
  .then(found => main(found.Ros ? found : found.default))
  .catch(error => { console.error(error); process.exit(1); });
